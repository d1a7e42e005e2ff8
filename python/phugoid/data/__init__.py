"""Experiments: records read, filtered, put together, checked."""
