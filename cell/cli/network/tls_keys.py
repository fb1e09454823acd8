"""``cell keys``: a private certificate authority, a certificate for every role, and the Zenoh files that use them."""

from __future__ import annotations

import ipaddress
import os
import shutil
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.ec import SECP256R1, EllipticCurvePrivateKey, generate_private_key
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from bus.errors import ConfigError
from bus.secrets import require_outside, require_private
from config.load import DEFAULT_STATION

ROLES = ("cell", "router", "node", "operator", "viewer")
LISTENING = ("cell", "router")
"""Roles that others connect to; clients check that the certificate names the requested address."""
_FILES = DEFAULT_STATION.parent / "zenoh"
_VALID = timedelta(days=2 * 365)
_CA_VALID = timedelta(days=10 * 365)
_SIGNS = x509.KeyUsage(
    digital_signature=False, content_commitment=False, key_encipherment=False, data_encipherment=False,
    key_agreement=False, key_cert_sign=True, crl_sign=True, encipher_only=False, decipher_only=False,
)  # fmt: skip
"""An authority signs certificates, and nothing else."""


def make_keys(folder: Path, hosts: Sequence[str]) -> list[Path]:
    """Write ``ROLE.pem``, ``ROLE.key`` and ``ROLE.json5`` for every role into ``folder``.

    An existing authority (``ca.pem``, ``ca.key``) is reused, so earlier certificates stay valid; otherwise it is
    created.

    Args:
        hosts: addresses and names under which the cell and the router are reached.

    Returns: the written files.

    Raises: ConfigError for an invalid host, or a folder that cannot be written.
    """
    require_outside(folder / "ca.key", "TLS key")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        authority, key, written = _authority(folder)
        for role in ROLES:
            own = generate_private_key(SECP256R1())
            names = host_names(hosts) if role in LISTENING else []
            written += [write_key(folder / f"{role}.key", own)]
            written += [write_certificate(folder / f"{role}.pem", _certificate(role, own, names, authority, key))]
            if not (folder / f"{role}.json5").exists():
                written.append(Path(shutil.copy(_FILES / f"{role}.json5", folder)))
    except OSError as error:
        raise ConfigError(f"Cannot write keys into {folder}: {error.strerror}.") from error
    return written


def _authority(folder: Path) -> tuple[x509.Certificate, EllipticCurvePrivateKey, list[Path]]:
    """The folder's authority, created if there is none, and the files written for it."""
    pem, secret = folder / "ca.pem", folder / "ca.key"
    if pem.exists() and secret.exists():
        require_private(secret, "TLS key")
        key = load_pem_private_key(secret.read_bytes(), password=None)
        assert isinstance(key, EllipticCurvePrivateKey)
        return x509.load_pem_x509_certificate(pem.read_bytes()), key, []
    key = generate_private_key(SECP256R1())
    name = _called("VLAD Cell authority")
    certificate = (
        _builder(name, name, key, key, _CA_VALID)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_SIGNS, critical=True)
        .sign(key, hashes.SHA256())
    )
    return certificate, key, [write_key(secret, key), write_certificate(pem, certificate)]


def _certificate(
    role: str,
    key: EllipticCurvePrivateKey,
    names: list[x509.GeneralName],
    authority: x509.Certificate,
    authority_key: EllipticCurvePrivateKey,
) -> x509.Certificate:
    """A certificate with the role as common name, valid for the addresses ``names``."""
    usages = [ExtendedKeyUsageOID.CLIENT_AUTH]
    usages += [ExtendedKeyUsageOID.SERVER_AUTH] if names else []
    return (
        _builder(_called(role), authority.subject, key, authority_key, _VALID)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName(names or [x509.DNSName(role)]), critical=False)
        .add_extension(x509.ExtendedKeyUsage(usages), critical=False)
        .sign(authority_key, hashes.SHA256())
    )


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: EllipticCurvePrivateKey,
    issuer_key: EllipticCurvePrivateKey,
    valid: timedelta,
) -> x509.CertificateBuilder:
    """A certificate that names both keys, as strict clients ask for (RFC 5280; Python from 3.13 on)."""
    own, issuers = key.public_key(), issuer_key.public_key()
    now = datetime.now(UTC) - timedelta(hours=1)  # clocks differ
    return (
        x509.CertificateBuilder(subject_name=subject, issuer_name=issuer, public_key=own)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now)
        .not_valid_after(now + valid)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(own), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(issuers), critical=False)
    )


def _called(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def host_names(hosts: Sequence[str]) -> list[x509.GeneralName]:
    """Addresses and names for a certificate, this machine's own among them. Raises: ConfigError."""
    return [_name(host) for host in dict.fromkeys((*hosts, "127.0.0.1", "localhost"))]


def _name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError as error:
        raise ConfigError(f"{host!r} is neither an address nor a host's name.") from error


def write_certificate(path: Path, certificate: x509.Certificate) -> Path:
    """Write a certificate as PEM."""
    path.write_bytes(certificate.public_bytes(Encoding.PEM))
    return path


def write_key(path: Path, key: EllipticCurvePrivateKey | RSAPrivateKey) -> Path:
    """Write a key, readable by the owner only from its creation."""
    path.unlink(missing_ok=True)
    with os.fdopen(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        file.write(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return path
