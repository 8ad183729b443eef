"""Tests against results that other programs, textbooks and papers publish."""
