"""A connection that never waits: asked by a timer, it gives what has come since it was last asked."""

import json
import socket
import time

from UrsnavLiveLib.messages import HEADER, LARGEST_BODY, Pose, Text, decode

#: Bytes taken from the socket at once, and how often at most in one call, so that the window stays alive.
_CHUNK, _CHUNKS = 1 << 18, 64


class Receiver:
    """Receives what ``ursnav navigate hardware/output=slicer`` sends.

    Args:
        host, port: where it listens.
        quiet_s: a pose older than this is old.
        clock: seconds.
    """

    def __init__(self, host="127.0.0.1", port=18944, quiet_s=2.0, clock=time.monotonic):
        self.host, self.port, self.quiet_s = host, port, quiet_s
        self.coverage = {}
        self.problem = ""
        self._clock, self._socket, self._pending = clock, None, bytearray()
        self._pose_at = None

    @property
    def is_connected(self):
        """Whether there is somebody at the other end."""
        return self._socket is not None

    @property
    def is_old(self):
        """Whether the last pose is too old to be believed, or there was none."""
        return self._pose_at is None or self._clock() - self._pose_at > self.quiet_s

    def connect(self, timeout_s=1.0):
        """Connect.

        Raises:
            OSError: nobody listens there.
        """
        self.close()
        self._socket = socket.create_connection((self.host, self.port), timeout_s)
        self._socket.setblocking(False)
        self.problem = ""

    def close(self):
        """Disconnect; nothing happens where there is no connection."""
        if self._socket is not None:
            self._socket.close()
        self._socket, self._pending, self._pose_at = None, bytearray(), None

    def poll(self):
        """What has come, oldest first; of a device that told several things only the newest.

        A sender that has left, or is none, ends the connection; `problem` says why.
        """
        if self._socket is None:
            return []
        gone = self._receive()
        newest = {}
        try:
            for message in self._whole():
                newest[type(message), message.device] = message
        except ValueError as error:
            gone = str(error)
        for message in newest.values():
            self._note(message)
        if gone:
            self.close()
            self.problem = gone
        return list(newest.values())

    def _receive(self):
        """Take what the socket has; a reason where it has ended."""
        for _ in range(_CHUNKS):
            try:
                data = self._socket.recv(_CHUNK)
            except BlockingIOError:
                return ""
            except OSError as error:
                return str(error)
            if not data:
                return "the sender has left"
            self._pending += data
        return ""

    def _whole(self):
        while len(self._pending) >= HEADER.size:
            version, kind, device, _, size, _ = HEADER.unpack_from(self._pending)
            if version not in (1, 2) or size > LARGEST_BODY:
                raise ValueError("what comes is not OpenIGTLink; is the port right?")
            if len(self._pending) < HEADER.size + size:
                return
            body = bytes(self._pending[HEADER.size : HEADER.size + size])
            del self._pending[: HEADER.size + size]
            names = (name.split(b"\0")[0].decode("ascii", "replace") for name in (kind, device))
            message = decode(*names, version, body)
            if message is not None:
                yield message

    def _note(self, message):
        if isinstance(message, Pose) and message.matrix is not None:
            self._pose_at = self._clock()
        elif isinstance(message, Text) and message.device == "Coverage":
            try:
                self.coverage = {str(name): (str(word), float(share)) for name, (word, share) in
                                 json.loads(message.text).items()}  # fmt: skip
            except (ValueError, TypeError, AttributeError):
                self.problem = "the coverage is not understood; is the sender of the same version?"
