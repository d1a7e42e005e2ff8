"""What a simulation gets wrong, in numbers, words and figures."""
