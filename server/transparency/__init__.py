"""The transparency log: one Merkle tree of everything that is signed, in the form of RFC 6962 and C2SP tlog-tiles."""
