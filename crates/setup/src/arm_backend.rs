//! Names of the arm backends.

use serde::Deserialize;

/// Arm backends.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum ArmBackend {
    Mock,
    Emulated,
    Serial,
    Tcp,
    Local,
}

/// Whether this word is a backend of arms outside this program. An unknown word is none: it is refused as such.
pub(crate) fn is_real_backend(word: &str) -> bool {
    let known = ArmBackend::deserialize(serde::de::value::StrDeserializer::<serde::de::value::Error>::new(word));
    match known {
        Ok(ArmBackend::Serial | ArmBackend::Tcp | ArmBackend::Local) => true,
        Ok(ArmBackend::Mock | ArmBackend::Emulated) | Err(_) => false,
    }
}
