"""Wrapping of muscle and ligament lines over obstacles on the bones."""
