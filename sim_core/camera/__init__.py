"""What the bench's camera sees: its view, the bench, load and film as they look, and the pictures of a test."""
