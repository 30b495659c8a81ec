"""Where compiled kernels are kept on this machine, who compiles, and how far it is; nothing here needs a compiler."""
