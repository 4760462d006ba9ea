"""Captures: files of what came over the wire, and what stands beside them."""

from solenav.capture.contents import Capture, load
from solenav.capture.file import CaptureWriter, read_records

__all__ = ["Capture", "CaptureWriter", "load", "read_records"]
