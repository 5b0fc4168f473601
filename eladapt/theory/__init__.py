"""What is proven of the controllers: bounds, certificates, Lyapunov functions."""
