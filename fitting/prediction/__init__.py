"""Predictions: outcomes of many variants of treatments, with an estimate's uncertainty."""
