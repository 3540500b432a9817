"""The node graph, its supervisor and the command line."""
