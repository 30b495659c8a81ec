"""What keeps a policy inside its sandbox: namespaces, control groups, system call filter, process tracing."""
