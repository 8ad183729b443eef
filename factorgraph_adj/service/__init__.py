"""The stream protocol: requests as JSON lines, answers as JSON lines."""
