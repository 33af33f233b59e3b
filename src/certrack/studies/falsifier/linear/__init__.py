"""The worst case of a linear error loop: signs of kernels, and linear programs."""
