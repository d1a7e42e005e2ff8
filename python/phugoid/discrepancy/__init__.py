"""What a fitted model is missing: shown, named, added, and the gain measured."""
