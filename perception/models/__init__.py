"""The models that imagine: what they must do (`base`), and the one that needs no network (`geometric`)."""
