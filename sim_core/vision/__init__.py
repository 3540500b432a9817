"""Displacement measured from pictures: targets, markers and carton faces tracked, and judged with an uncertainty."""
