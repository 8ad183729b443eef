"""The command ``factorgraph-adj``."""
