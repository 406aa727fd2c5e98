"""The model: parameters, metrics, equations, kernels."""
