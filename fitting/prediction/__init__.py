"""Predicts motions and outcomes of treatments for many variants, with an estimate's uncertainty."""
