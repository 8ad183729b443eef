"""Field books: readings as they were taken, reduced to observations."""
