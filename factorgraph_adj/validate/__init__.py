"""What is wrong with a network before it is adjusted."""
