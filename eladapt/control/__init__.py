"""Control laws, and the controllers made of them."""
