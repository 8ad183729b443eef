"""What has arrived, what became of it, and the journal of that."""
