"""Planning before measuring: what a design will give, and what to add to it."""
