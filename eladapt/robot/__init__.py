"""The robot and its regressors."""
