//! Trial of the release in a clean root: an empty one for the archive, a fresh Debian for the package.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};

use super::Release;
use crate::apt::is_root;
use crate::files::{copy, create_folder, remove_folder};
use crate::not_possible::NotPossible;
use crate::workspace::{Workspace, run_visibly};

/// One changed parameter, as on the first page of the documentation.
const RUN: [&str; 10] =
    ["run", "--config", "sim", "--set", "scene.target=card", "--set", "run.pace=fast", "--stop-after", "2", "--out"];

/// Unpacks the archive in an empty root, without libraries, shell and `/proc`, and runs the program there.
///
/// # Errors
/// If the program does not work as required.
pub fn of_archive(workspace: &Workspace, release: &Release, archive: &Path) -> anyhow::Result<()> {
    let root = emptied(&release.folder.join("empty-root"))?;
    let mut tar = workspace.command("tar");
    run_visibly(tar.arg("-xzf").arg(archive).arg("--strip-components=1").arg("-C").arg(&root))?;
    let program = Installed { workspace, root, path: "/bin/pb3dp" };
    program.try_everything(release)
}

/// Installs the package in a fresh Debian, runs the program there, and removes the package again.
///
/// # Errors
/// [`NotPossible`] without debootstrap or the right to use it; otherwise if the package does not work as required.
pub fn of_package(workspace: &Workspace, release: &Release, package: &Path, mirror: &str) -> anyhow::Result<()> {
    if workspace.output_of("debootstrap", &["--version"]).is_none() {
        return Err(NotPossible::because(
            "the package was built, but not tried: debootstrap is missing (run apt-get install debootstrap)",
        ));
    }
    if !is_root() {
        return Err(NotPossible::because("the package was built, but not tried: debootstrap and chroot need root"));
    }
    let root = emptied(&release.folder.join("debian-root"))?;
    let mut debootstrap = workspace.command("debootstrap");
    debootstrap.args(["--variant=minbase", "--include=systemd,udev,man-db", "stable"]).arg(&root).arg(mirror);
    run_visibly(&mut debootstrap)?;
    copy(package, &root.join("pb3dp.deb"))?;
    let debian = Installed { workspace, root: root.clone(), path: "/usr/bin/pb3dp" };
    debian.run("dpkg", &["--install", "/pb3dp.deb"])?;
    debian.try_everything(release)?;
    for (program, args) in [
        ("man", &["--where", "pb3dp-run"][..]),
        ("systemd-analyze", &["verify", "--man=no", "/usr/lib/systemd/system/pb3dp-gateway@.service"]),
        ("getent", &["passwd", "pb3dp"]),
        ("getent", &["group", "realtime"]),
        ("dpkg", &["--remove", "pb3dp"]),
    ] {
        debian.run(program, args)?;
    }
    let rules = root.join("etc/udev/rules.d/70-pb3dp.rules");
    if root.join("usr/bin/pb3dp").exists() || !rules.is_file() {
        bail!("after --remove the program must be gone, and {} must exist", rules.display());
    }
    debian.run("dpkg", &["--purge", "pb3dp"])?;
    if rules.exists() || root.join("usr/share/doc/pb3dp").exists() {
        bail!("after --purge no file of pb3dp may remain below {}", root.display());
    }
    println!("pb3dp {}: the package works in a fresh Debian", release.version);
    Ok(())
}

/// A root with an installed program.
struct Installed<'a> {
    workspace: &'a Workspace,
    root: PathBuf,
    /// Path of the program inside the root.
    path: &'static str,
}

impl Installed<'_> {
    fn command(&self, program: &str, args: &[&str]) -> Command {
        let mut command = self.workspace.command("unshare");
        // `unshare` instead of `chroot`, because it also works without root.
        if !is_root() {
            command.arg("--map-root-user");
        }
        command.arg(format!("--root={}", self.root.display())).arg("--wd=/");
        command.env_clear().env("PATH", "/usr/sbin:/usr/bin:/sbin:/bin").arg(program).args(args);
        command
    }

    fn run(&self, program: &str, args: &[&str]) -> anyhow::Result<()> {
        run_visibly(&mut self.command(program, args))
    }

    /// Runs the program; it must end with `code`, and print `part`.
    fn expect(&self, args: &[&str], code: i32, part: &str) -> anyhow::Result<()> {
        println!("$ pb3dp {}", args.join(" "));
        let output = self.command(self.path, args).output().context("cannot start unshare")?;
        let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
        if output.status.code() != Some(code) || !text.contains(part) {
            bail!("`pb3dp {}` must end with {code} and print `{part}`, but: {}\n{text}", args.join(" "), output.status);
        }
        Ok(())
    }

    /// The first steps of a user: a new setup, one changed parameter, a typo of each kind, the explanation of a code.
    fn try_everything(&self, release: &Release) -> anyhow::Result<()> {
        self.expect(&["--version"], 0, &release.version)?;
        self.expect(&["config", "check", "--config", "sim"], 0, "")?;
        self.expect(&["config", "explain", "scene.target"], 0, "potato")?;
        self.expect(&[&RUN[..], &["out"]].concat(), 0, "")?;
        let summary = self.root.join("out/summary.json");
        if !summary.is_file() || !self.root.join("out/report.html").is_file() {
            bail!("{}: the run wrote no summary or no report", summary.display());
        }
        self.expect(&["run", "--config", "sin", "--out", "no"], 1, "sim")?;
        self.expect(
            &["run", "--config", "sim", "--set", "scene.tarjet=card", "--out", "no"],
            1,
            "did you mean target",
        )?;
        self.expect(&["rum"], 2, "run")?;
        self.expect(&["calibrate", "board", "--help"], 0, "Usage")?;
        self.expect(&["explain", "PB3DP-CFG-001"], 0, "remedy")?;
        self.expect(&["completions", "bash"], 0, "_pb3dp")
    }
}

fn emptied(folder: &Path) -> anyhow::Result<PathBuf> {
    remove_folder(folder)?;
    create_folder(folder)?;
    Ok(folder.to_path_buf())
}
