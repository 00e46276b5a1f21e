"""The live treatment page of `pftwin app`: sliders, and the whole motion simulated at every move of them."""
