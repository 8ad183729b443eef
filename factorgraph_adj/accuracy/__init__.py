"""Accuracy statements of standards: positions of check points, tests of instruments, budgets."""
