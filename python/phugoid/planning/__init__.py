"""What a manoeuvre that is planned would tell: standard errors, weak directions, and how far the vehicle would go."""
