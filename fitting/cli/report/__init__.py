"""The report: one HTML page, offline, that a clinician can read; of a fit, of a result, or of the demo's folder."""
