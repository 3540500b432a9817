"""Closed forms and independent solutions that the physics is held against."""
