"""What a comparison of two epochs says: its protocol, its tables, and its results for programs."""
