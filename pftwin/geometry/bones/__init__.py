"""Femur, patella and tibia as smooth bodies, generated from anatomical parameters."""
