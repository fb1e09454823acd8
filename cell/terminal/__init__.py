"""How a process of ours speaks with who started it: lines, tables, signals."""
