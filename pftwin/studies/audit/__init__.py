"""Cost of each effect of a scene and its influence on the result: `pftwin explain` and `pftwin audit`."""
