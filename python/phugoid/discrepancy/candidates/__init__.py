"""What a model may be missing."""
