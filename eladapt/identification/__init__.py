"""From a log to a model: what an arm's parameters are, how well the log tells them, and its URDF again."""
