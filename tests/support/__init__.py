"""References, checks and places of files that several tests share."""
