"""Commands about recorded cycles, and what is made of them."""
