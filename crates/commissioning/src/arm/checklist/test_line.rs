//! The line to an arm that is emulated for a test, which a second process of the test uses as well.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use pb3dp_arm_pa10_emulation::line::mock_server::SocketAddr;
use pb3dp_hal_platform::key_file::{random_bytes, write_new_key};

/// Address and key of an arm that is emulated for a test.
pub struct TestLine {
    /// Address of its gateway.
    pub address: SocketAddr,
    /// Key of its gateway.
    pub key: TestKey,
}

/// A key file that is deleted with its owner.
pub struct TestKey(PathBuf);

impl TestKey {
    /// Makes a new key in the folder for temporary files.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn new() -> Result<Self> {
        let name = format!("pb3dp-{:016x}.key", u64::from_le_bytes(random_bytes()?));
        let file = std::env::temp_dir().join(name);
        write_new_key(&file).context("the key of the emulated arm")?;
        Ok(Self(file))
    }

    /// The file.
    pub fn file(&self) -> &Path {
        &self.0
    }
}

impl Drop for TestKey {
    fn drop(&mut self) {
        std::fs::remove_file(&self.0).ok();
    }
}
