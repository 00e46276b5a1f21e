"""Lines that run over obstacles on the bones."""
