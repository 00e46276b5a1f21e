"""Femur, patella and tibia as smooth bodies made from anatomical numbers."""
