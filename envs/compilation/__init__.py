"""How every numerical kernel is compiled, and where its machine code is stored."""

from .kernels import allocating_kernel, kernel, large_kernel

__all__ = ["allocating_kernel", "kernel", "large_kernel"]
