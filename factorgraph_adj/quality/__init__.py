"""Quality of results: precision, reliability, gross errors, variance components, the datum."""
