"""Where two surfaces touch: facets, contours, overlaps and depths."""
