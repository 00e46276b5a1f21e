"""The virtual rig's laboratory: the plant behind the measurements in `pftwin/rig/data`, and how they are taken."""
