"""Speed for accuracy: what every setting costs and gives, measured on a user's own photos."""
