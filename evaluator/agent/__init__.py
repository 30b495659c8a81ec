"""The untrusted side: how a submitted policy is started, isolated, asked for actions and judged when it fails."""
