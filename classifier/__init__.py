"""From bags to a trained video classifier and back."""
