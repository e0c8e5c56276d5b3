//! Certificates of gateways in tests, and gateways with TLS.

use pb3dp_arm_pa10::arm::{GatewayIdentity, KeyedTcp, PinnedCertificate, write_new_certificate};
use pb3dp_arm_pa10_gateway::service::{Access, HostSide};

use crate::world::{ARM, keyed, test_key};

/// A new certificate: the side of the gateway, and that of its hosts.
pub fn new_certificate() -> (GatewayIdentity, PinnedCertificate) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("gateway.crt");
    let key = write_new_certificate(&file).unwrap();
    (GatewayIdentity::read(&file, &key).unwrap(), PinnedCertificate::read(&file).unwrap())
}

/// A gateway's TCP port with TLS, and a host for it.
pub fn tls_side() -> (HostSide, KeyedTcp) {
    let (identity, certificate) = new_certificate();
    side_with(identity, certificate)
}

/// The same with this certificate.
pub fn side_with(identity: GatewayIdentity, certificate: PinnedCertificate) -> (HostSide, KeyedTcp) {
    let access = Access { tls: Some(identity), ..Access::from_this_computer(test_key()) };
    let side = HostSide::listen("127.0.0.1:0".parse().unwrap(), ARM, access).unwrap();
    let host = KeyedTcp { certificate: Some(certificate), ..keyed(side.address().unwrap()) };
    (side, host)
}
