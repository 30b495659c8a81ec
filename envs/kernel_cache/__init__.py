"""Where compiled kernels are stored on this machine, who compiles, and its progress; nothing here needs a compiler."""
