"""The misfit of a fitted model: its causes, found, named, and added to the model."""
