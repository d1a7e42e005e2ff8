"""The filter-error method: estimates with process noise."""
