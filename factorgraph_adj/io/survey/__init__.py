"""Field books, and files of programs for survey networks."""
