"""What detection is compared with: images without depth."""
