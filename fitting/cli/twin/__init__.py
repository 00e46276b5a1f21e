"""The twin in a file (`pftwin twin`): a scene's programs compiled to WebAssembly, in one page that needs no Python."""
