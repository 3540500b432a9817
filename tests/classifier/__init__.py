"""Tests of the classifier: network, frames, export."""
