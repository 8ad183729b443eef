"""The blocks of El-Hakim & Faig (1981) and El-Hakim (1986), simulated."""
