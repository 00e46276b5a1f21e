"""The twin in a file of `pftwin twin`: a scene's compiled programs as WebAssembly, in one page that needs no Python."""
