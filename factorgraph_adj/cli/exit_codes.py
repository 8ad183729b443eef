"""Exit codes of all commands."""

FINE = 0
"""The command did what it was asked for."""
DOUBTFUL = 1
"""The result has not converged, fails the global test, has gross errors left or misses a target."""
BAD_INPUT = 2
"""Options or files are wrong, or the observations do not determine the unknowns."""
FAULT = 3
"""The program itself failed."""
INTERRUPTED = 130
"""The user interrupted the command: 128 and the number of SIGINT, as shells count."""
