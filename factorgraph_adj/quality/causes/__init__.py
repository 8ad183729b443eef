"""Causes of misfits that surveyors know: shared errors, exchanges, wrong axes, bent blocks."""
