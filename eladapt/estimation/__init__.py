"""From measurements to parameter estimates."""
