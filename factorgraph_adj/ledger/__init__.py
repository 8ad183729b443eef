"""The ledger of arriving observations and their outcomes, its journal lines, checked input."""
