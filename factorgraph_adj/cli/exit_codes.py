"""Exit codes of all commands."""

FINE = 0
"""The command succeeded."""
DOUBTFUL = 1
"""The result has not converged, fails the global test, has gross errors or misses a target; or
readings do not agree before any adjustment."""
BAD_INPUT = 2
"""Options or files are wrong, or the observations do not determine the unknowns."""
FAULT = 3
"""The program itself failed."""
INTERRUPTED = 130
"""The user interrupted the command: 128 + the number of SIGINT, the convention of shells."""
