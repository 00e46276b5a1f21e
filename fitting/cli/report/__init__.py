"""The report of `pftwin report`: a fit, a result or the demo's folder as one offline HTML page for clinicians."""
