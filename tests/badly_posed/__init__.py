"""Badly posed small networks, and how near the minimum their adjustments end."""
