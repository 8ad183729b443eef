"""The stream protocol: commands and observations as JSON lines, answers as JSON lines."""
