"""The regressors of adaptive control, in base parameters."""
