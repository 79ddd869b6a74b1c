"""A zip of which one member changes, with checksums that are right: what is inside gets fuzzed."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib

LOCAL, ENTRY, END = 0x04034B50, 0x02014B50, 0x06054B50  # signatures (APPNOTE.TXT, section 4.3)
VERSION = 20  # 2.0, which knows folders
DATE = 0x21  # 1 January 1980, the first there is
LENGTH_OF_END = 22


class Bundle:
    """Puts bytes in the place of one member; zipfile itself would take longer than most readers."""

    def __init__(self, whole: bytes, ending: str) -> None:
        """Take a good zip apart.

        Args:
            whole: its bytes.
            ending: of the name of the member that will be replaced.
        """
        buffer = io.BytesIO()
        with zipfile.ZipFile(io.BytesIO(whole)) as source:
            (name,) = (name for name in source.namelist() if name.endswith(ending))
            others = [other for other in source.namelist() if other != name]
            with zipfile.ZipFile(buffer, "w") as target:
                for other in others:
                    target.writestr(other, source.read(other))
        data = buffer.getvalue()
        start = struct.unpack_from("<I", data, len(data) - 6)[0]
        self.members, self.entries = data[:start], data[start:-LENGTH_OF_END]
        self.count = len(others) + 1
        self.name = name.encode()

    def having(self, data: bytes) -> bytes:
        """The zip with these bytes as that member, stored."""
        facts = (0, 0, 0, DATE, zlib.crc32(data), len(data), len(data), len(self.name), 0)
        member = struct.pack("<IHHHHHIIIHH", LOCAL, VERSION, *facts) + self.name + data
        place = (0, 0, 0, 0, len(self.members))
        entry = struct.pack("<IHHHHHHIIIHHHHHII", ENTRY, VERSION, VERSION, *facts, *place)
        entries = self.entries + entry + self.name
        start = len(self.members) + len(member)
        end = (0, 0, self.count, self.count, len(entries), start, 0)
        return self.members + member + entries + struct.pack("<IHHHHIIH", END, *end)
