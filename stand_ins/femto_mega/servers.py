"""The servers of the camera stand-in: vendor control (8090), depth (8554) and colour (8888) over RTSP."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable

from stand_ins.femto_mega.device import Device, Pair

CONTROL, DEPTH, COLOR = 8090, 8554, 8888
_REQUEST, _RESPONSE = 0x4D47, 0x4252
_UNSUPPORTED, _NOT_FOUND = 2, 6
_FRAGMENT = 8000


class Server:
    """Listens on one port; each connection gets a thread. `die` is a pulled plug, `live` its return."""

    def __init__(self, host: str, port: int, serve: Callable[[socket.socket], None]) -> None:
        self._address, self._serve = (host, port), serve
        self._connections: list[socket.socket] = []
        self.live()

    def live(self) -> None:
        self._listener = socket.socket()
        self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        self._listener.bind(self._address)
        self._listener.listen()
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def die(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        for connection in self._connections:
            try:
                connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                connection.shutdown(socket.SHUT_RDWR)
                connection.close()
            except OSError:
                continue  # closed already
        self._connections.clear()

    def _accept(self, listener: socket.socket) -> None:
        while True:
            try:
                connection, _ = listener.accept()
            except OSError:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connections.append(connection)
            threading.Thread(target=self._run, args=(connection,), daemon=True).start()

    def _run(self, connection: socket.socket) -> None:
        try:
            self._serve(connection)
        except (OSError, EOFError):  # the SDK ends its connections with a reset
            return
        finally:
            connection.close()


def _exactly(connection: socket.socket, count: int) -> bytes:
    data = b""
    while len(data) < count:
        more = connection.recv(count - len(data))
        if not more:
            raise EOFError
        data += more
    return data


def control(device: Device) -> Callable[[socket.socket], None]:
    """The vendor protocol: properties and long lists."""

    def serve(connection: socket.socket) -> None:
        while True:
            magic, halfwords, opcode, number = struct.unpack("<4H", _exactly(connection, 8))
            body = _exactly(connection, 2 * halfwords)
            if magic != _REQUEST or device.frozen:
                continue
            error, payload = _answer(device, opcode, body)
            payload += bytes(len(payload) % 2)
            connection.sendall(struct.pack("<5H", _RESPONSE, 1 + len(payload) // 2, opcode, number, error) + payload)

    return serve


def _answer(device: Device, opcode: int, body: bytes) -> tuple[int, bytes]:
    number = int.from_bytes(body[:4], "little")
    if opcode == 1:
        return 0, struct.pack("<5i", device.ints.get(number, 0), 2**30, 0, 0, 1)
    if opcode == 2:
        device.ints[number] = struct.unpack("<i", body[4:8])[0]
        return 0, b""
    if opcode == 3:
        found = device.struct_of(number)
        return (0, found) if found is not None else (_NOT_FOUND, b"")
    if opcode == 4:
        device.structs[number] = body[4:]
        return 0, b""
    if opcode == 5:
        return 0, bytes(8)
    if opcode in (17, 18, 19):
        return _raw(device, opcode, number, body)
    return _UNSUPPORTED, b""


def _raw(device: Device, opcode: int, number: int, body: bytes) -> tuple[int, bytes]:
    found = device.raw(number)
    if found is None:
        return _NOT_FOUND, b""
    if opcode == 17:
        return 0, struct.pack("<I", len(found))
    if opcode == 18:
        offset, size = struct.unpack("<II", body[4:12])
        return 0, found[offset : offset + size]
    return 0, b""


class Rtsp:
    """One sensor's stream: DESCRIBE, SETUP, PLAY, then interleaved RTP until TEARDOWN.

    Args:
        codec: as the SDK names it. ``part``: a pair's bytes for this sensor. ``size``: (width, height).
    """

    def __init__(self, device: Device, codec: str, part: Callable[[Pair], bytes], size: tuple[int, int]) -> None:
        self._device, self._codec, self._part, self._size = device, codec, part, size

    def serve(self, connection: socket.socket) -> None:
        stream = connection.makefile("rb")
        sending, ended = threading.Lock(), threading.Event()
        try:
            while (first := stream.read(1)) != b"":
                if first == b"$":  # RTCP from the client
                    _, length = struct.unpack(">BH", stream.read(3))
                    stream.read(length)
                    continue
                line = (first + stream.readline()).decode()
                self._request(connection, line, _headers(stream), sending, ended)
        finally:
            ended.set()

    def _request(
        self, connection: socket.socket, line: str, headers: dict[str, str], sending: threading.Lock,
        ended: threading.Event,
    ) -> None:  # fmt: skip
        method, url = line.split()[:2]
        extra, body = "", ""
        if method == "DESCRIBE":
            body = (
                "v=0\r\no=- 1 1 IN IP4 0.0.0.0\r\ns=stream\r\nt=0 0\r\na=control:*\r\nm=video 0 RTP/AVP 96\r\n"
                f"c=IN IP4 0.0.0.0\r\na=rtpmap:96 {self._codec}/90000\r\na=control:track1\r\n"
            )
            extra = f"Content-Base: {url}/\r\nContent-Type: application/sdp\r\nContent-Length: {len(body)}\r\n"
        elif method == "SETUP":
            extra = "Transport: RTP/AVP/TCP;unicast;interleaved=0-1\r\nSession: 12345678;timeout=65\r\n"
        elif method == "PLAY":
            extra = "Session: 12345678\r\nRange: npt=0.000-\r\n"
        elif method == "TEARDOWN":
            ended.set()
        with sending:
            connection.sendall(f"RTSP/1.0 200 OK\r\nCSeq: {headers['cseq']}\r\n{extra}\r\n{body}".encode())
        if method == "PLAY":
            threading.Thread(target=self._play, args=(connection, sending, ended), daemon=True).start()

    def _play(self, connection: socket.socket, sending: threading.Lock, ended: threading.Event) -> None:
        sequence, number = 0, -1
        while not ended.is_set():
            pair = self._device.after(number)
            if pair is None:
                continue
            number = pair.number
            frame = struct.pack("<QHQII", pair.number, 0, pair.stamp_us, *self._size) + self._part(pair)
            try:
                with sending:
                    sequence = _send(connection, frame, pair.stamp_us, sequence)
            except OSError:
                return


def _send(connection: socket.socket, frame: bytes, stamp_us: int, sequence: int) -> int:
    """One frame as RTP packets; returns the next sequence number."""
    packets = []
    for offset in range(0, len(frame), _FRAGMENT):
        fragment = frame[offset : offset + _FRAGMENT]
        last = 0x80 if offset + _FRAGMENT >= len(frame) else 0
        rtp = struct.pack(">BBHII", 0x80, 96 | last, sequence & 0xFFFF, stamp_us * 9 // 100 & 0xFFFFFFFF, 1)
        packets.append(struct.pack(">cBH", b"$", 0, len(rtp) + len(fragment)) + rtp + fragment)
        sequence += 1
    connection.sendall(b"".join(packets))
    return sequence


def _headers(stream: object) -> dict[str, str]:
    headers = {}
    while (line := stream.readline().strip()) != b"":  # type: ignore[attr-defined]
        name, _, value = line.decode().partition(":")
        headers[name.strip().lower()] = value.strip()
    return headers
