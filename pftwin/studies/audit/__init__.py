"""What each effect of a scene costs and is worth: `pftwin explain` and `pftwin audit`."""
