//! The files of a cell: the setup of the program, the settings of both gateways, and their key.

use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, ensure};
use system_tests::repository;
use toml::{Table, Value};

/// Keys of both arms in a setup.
const KEYS: [&str; 2] = ["vs", "tc"];

/// A folder with the files of a cell.
pub struct Files {
    folder: tempfile::TempDir,
    addresses: [SocketAddr; 2],
}

impl Files {
    /// The files of a cell whose gateways listen at these addresses.
    pub fn new(program: &Path, addresses: [SocketAddr; 2]) -> Result<Self> {
        let files = Self { folder: tempfile::tempdir()?, addresses };
        let key = files.path("arm.key");
        let made = Command::new(program).args(["gateway", "key"]).arg(&key).output()?;
        ensure!(made.status.success(), "pb3dp gateway key: {}", String::from_utf8_lossy(&made.stderr));
        fs::write(files.setup(), files.setup_text(addresses)?)?;
        for (arm, address) in addresses.into_iter().enumerate() {
            fs::write(files.gateway(arm), files.gateway_text(arm, address)?)?;
        }
        Ok(files)
    }

    /// A path in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The address of the gateway of an arm.
    pub fn address(&self, arm: usize) -> SocketAddr {
        self.addresses[arm]
    }

    /// The setup of the program.
    pub fn setup(&self) -> PathBuf {
        self.path("cell.toml")
    }

    /// The settings of a gateway.
    pub fn gateway(&self, arm: usize) -> PathBuf {
        self.path(&format!("gateway{arm}.toml"))
    }

    /// The socket in place of the bus of an arm.
    pub fn bus(&self, arm: usize) -> PathBuf {
        self.path(&format!("bus{arm}"))
    }

    /// The setup `hil` as one complete file, with arms behind TCP, slow enough to need no commissioning record.
    fn setup_text(&self, addresses: [SocketAddr; 2]) -> Result<String> {
        let mut setup = read("sim.toml")?;
        let robots = repository().join("configs/robots");
        let by_operator = |setup: &mut Table, policy: &str| {
            set(setup, &format!("supervisor.policies.{policy}.resume"), "by-operator".into())
        };
        for (key, value) in [
            ("run.pace", Value::from("live")),
            ("estimator.compare", Value::Array(Vec::new())),
            ("estimator.method", "geometric".into()),
            ("servo.arm_response.delay_millis", 17.0.into()),
            ("arms.first_run", true.into()),
            ("arms.speed_scale", 0.25.into()),
            ("experiment.move_s", 4.0.into()),
            ("experiment.lead_in_s", 0.5.into()),
        ] {
            set(&mut setup, key, value)?;
        }
        for policy in ["target_lost", "position_jump", "orientation_jump", "outlier"] {
            by_operator(&mut setup, policy)?;
        }
        for (arm, key) in KEYS.into_iter().enumerate() {
            let robot = robots.join("pa10_gen2.urdf").display().to_string();
            for (name, value) in [
                ("robot", Value::from(robot)),
                ("backend", "tcp".into()),
                ("gateway.address", addresses[arm].to_string().into()),
                ("gateway.key_file", self.path("arm.key").display().to_string().into()),
                ("gateway.arm", (arm as i64 + 1).into()),
                ("gateway.wire_format", "B".into()),
                ("gateway.geometry", "second-generation".into()),
            ] {
                set(&mut setup, &format!("arms.{key}.{name}"), value)?;
            }
        }
        Ok(toml::to_string(&setup)?)
    }

    /// The shipped settings, with a slower cycle and larger tolerances: this computer runs five programs that move arms.
    fn gateway_text(&self, arm: usize, address: SocketAddr) -> Result<String> {
        let mut gateway = read("gateway.toml")?;
        for (key, value) in [
            ("arm.number", Value::from(arm as i64 + 1)),
            ("arm.geometry", "second-generation".into()),
            ("bus.port", format!("socket:{}", self.bus(arm).display()).into()),
            ("bus.cycle_millis", 10.0.into()),
            ("bus.lateness_allowed_millis", 45.0.into()),
            ("host.line", format!("tcp:{address}").into()),
            ("access.key_file", self.path("arm.key").display().to_string().into()),
            ("realtime.priority", 45.into()),
        ] {
            set(&mut gateway, key, value)?;
        }
        Ok(toml::to_string(&gateway)?)
    }
}

/// A configuration file of the repository.
fn read(name: &str) -> Result<Table> {
    let file = repository().join("configs").join(name);
    let text = fs::read_to_string(&file).with_context(|| format!("cannot read {}", file.display()))?;
    Ok(text.parse::<Table>()?)
}

/// Sets a key; tables on the way to it are created.
fn set(table: &mut Table, key: &str, value: Value) -> Result<()> {
    let (mut at, mut rest) = (table, key);
    while let Some((first, others)) = rest.split_once('.') {
        let next = at.entry(first).or_insert_with(|| Value::Table(Table::new()));
        at = next.as_table_mut().with_context(|| format!("{key}: {first} is no table"))?;
        rest = others;
    }
    at.insert(rest.to_owned(), value);
    Ok(())
}
