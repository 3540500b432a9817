"""Campaigns: thousands of labelled tests, the same ones every time."""
