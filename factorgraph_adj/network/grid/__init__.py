"""Networks in grid coordinates become networks in a geocentric or topocentric frame."""
