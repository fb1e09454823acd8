"""The name that this program is installed by."""

from __future__ import annotations

OURS = "vlad-cell"
"""Our distribution: whose names no plug-in takes over, and whose version every recording has under this key."""
