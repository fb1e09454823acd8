"""What is said in the cell, and how it travels (Eclipse Zenoh). Imports nothing of ours."""
