"""``cell keys --opcua``: certificates for OPC UA, of the cell's server and of one client that it trusts."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPrivateKey, generate_private_key
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from bus.errors import ConfigError
from bus.secrets import require_outside
from cell.cli.network.tls_keys import host_names, write_certificate, write_key

_VALID = timedelta(days=2 * 365)
_KEY_BITS = 2048
"""OPC UA's policies want RSA."""


def make_opcua_keys(folder: Path, hosts: Sequence[str]) -> list[Path]:
    """Write ``cell.pem``, ``cell-key.pem``, ``client.pem``, ``client-key.pem`` and ``trusted/client.pem``.

    Every certificate is signed by itself: who may connect is a file in ``trusted``, and no longer may without it.

    Args:
        hosts: addresses and names under which the cell is reached.

    Raises: ConfigError for an invalid host, or a folder that cannot be written.
    """
    require_outside(folder / "cell-key.pem", "OPC UA key")
    names = host_names(hosts)
    try:
        (folder / "trusted").mkdir(parents=True, exist_ok=True)
        written = []
        for who, usage in (("cell", ExtendedKeyUsageOID.SERVER_AUTH), ("client", ExtendedKeyUsageOID.CLIENT_AUTH)):
            key = generate_private_key(65537, _KEY_BITS)
            certificate = _certificate(who, key, names, usage)
            written += [
                write_certificate(folder / f"{who}.pem", certificate),
                write_key(folder / f"{who}-key.pem", key),
            ]
        written.append(write_certificate(folder / "trusted" / "client.pem", certificate))
    except OSError as error:
        raise ConfigError(f"Cannot write keys into {folder}: {error.strerror}.") from error
    return written


def _certificate(
    who: str, key: RSAPrivateKey, names: list[x509.GeneralName], usage: x509.ObjectIdentifier
) -> x509.Certificate:
    """A certificate with the application URI that OPC UA compares, ``urn:vlad-cell:WHO``."""
    now = datetime.now(UTC) - timedelta(hours=1)  # clocks differ
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, f"VLAD Cell {who}")])
    usages = x509.KeyUsage(
        digital_signature=True, content_commitment=True, key_encipherment=True, data_encipherment=True,
        key_agreement=False, key_cert_sign=True, crl_sign=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    uri = x509.UniformResourceIdentifier(f"urn:vlad-cell:{who}")
    return (
        x509.CertificateBuilder(subject_name=subject, issuer_name=subject, public_key=key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now)
        .not_valid_after(now + _VALID)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(x509.SubjectAlternativeName([uri, *names]), critical=False)
        .add_extension(usages, critical=True)
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
        .sign(key, hashes.SHA256())
    )
