"""Cost and worth of each effect of a scene: `pftwin explain` and `pftwin audit`."""
