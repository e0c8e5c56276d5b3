//! The Debian package: the files of the archive below `/usr`, and those of a rig in the system folders.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::Context;

use super::Release;
use crate::files::{self, copy, copy_folder, remove_folder, write};
use crate::not_possible::NotPossible;
use crate::workspace::{Workspace, run_visibly};

/// Files of `configs/deploy`, and their places in the system. Files below `/etc` belong to the user after the installation.
/// The modules of ARCNET cards are omitted: only a rig with such a card needs them.
const DEPLOYED: [(&str, &str); 4] = [
    ("70-pb3dp.rules", "etc/udev/rules.d/70-pb3dp.rules"),
    ("90-pb3dp.conf", "etc/security/limits.d/90-pb3dp.conf"),
    ("pb3dp-sysusers.conf", "usr/lib/sysusers.d/pb3dp.conf"),
    ("pb3dp-gateway@.service", "usr/lib/systemd/system/pb3dp-gateway@.service"),
];

/// Runs after the installation. An upgrade never restarts a running gateway: an arm may depend on it at this moment.
const POSTINST: &str = r#"#!/bin/sh
set -e
if [ "$1" = configure ]; then
    if command -v systemd-sysusers > /dev/null; then
        systemd-sysusers pb3dp.conf
    else
        echo "pb3dp: systemd-sysusers is missing; create the groups of /usr/lib/sysusers.d/pb3dp.conf by hand"
    fi
    if [ -d /run/systemd/system ]; then systemctl daemon-reload; fi
    if [ -d /run/udev ]; then udevadm control --reload; fi
    echo "pb3dp: add each operator of a rig to its groups: usermod -aG video,dialout,realtime USER"
fi
"#;

const POSTRM: &str = r#"#!/bin/sh
set -e
if [ -d /run/systemd/system ]; then systemctl daemon-reload; fi
if [ -d /run/udev ]; then udevadm control --reload; fi
"#;

/// Builds the package from the tree of the archive.
///
/// # Errors
/// If `dpkg-deb` is missing or fails, or a file cannot be written.
pub fn build(workspace: &Workspace, release: &Release, tree: &Path) -> anyhow::Result<PathBuf> {
    let Some(architecture) = workspace.output_of("dpkg", &["--print-architecture"]) else {
        return Err(NotPossible::because("dpkg is missing: install the package dpkg to build a .deb"));
    };
    let root = release.folder.join("deb");
    remove_folder(&root)?;
    copy_folder(tree, &root.join("usr"))?;
    let functions = root.join("usr/share/zsh/site-functions");
    fs::rename(&functions, root.join("usr/share/zsh/vendor-completions"))
        .with_context(|| format!("cannot move {}", functions.display()))?;
    let documentation = root.join("usr/share/doc/pb3dp");
    let licences = ["LICENSE-MIT", "THIRD-PARTY.txt"].map(|name| fs::read_to_string(documentation.join(name)));
    let [own, others] = licences;
    write(&documentation.join("copyright"), &format!("{}\n\n{}", own?, others?))?;
    for (from, to) in DEPLOYED {
        copy(&workspace.root().join("configs/deploy").join(from), &root.join(to))?;
    }
    let size_kib =
        files::all(&root)?.iter().map(|file| fs::metadata(file).map_or(0, |found| found.len())).sum::<u64>() / 1024;
    write(&root.join("DEBIAN/control"), &control(&release.version, &architecture, size_kib))?;
    let of_user: String =
        DEPLOYED.iter().filter(|(_, to)| to.starts_with("etc/")).map(|(_, to)| format!("/{to}\n")).collect();
    write(&root.join("DEBIAN/conffiles"), &of_user)?;
    for (name, script) in [("postinst", POSTINST), ("postrm", POSTRM)] {
        let file = root.join("DEBIAN").join(name);
        write(&file, script)?;
        fs::set_permissions(&file, fs::Permissions::from_mode(0o755))?;
    }
    let package = release.folder.join(format!("pb3dp_{}_{architecture}.deb", release.version));
    run_visibly(workspace.command("dpkg-deb").args(["--root-owner-group", "--build"]).arg(&root).arg(&package))?;
    Ok(package)
}

/// The program is static, so the package has no dependencies.
fn control(version: &str, architecture: &str, size_kib: u64) -> String {
    format!(
        "Package: pb3dp\n\
         Version: {version}\n\
         Architecture: {architecture}\n\
         Maintainer: The pb3dp authors <pb3dp@localhost>\n\
         Section: science\n\
         Priority: optional\n\
         Installed-Size: {size_kib}\n\
         Recommends: systemd, udev\n\
         Description: pose of an unknown object from a stereo pair, and visual servoing\n \
         An operator points at any object in the left image of a calibrated stereo pair.\n \
         pb3dp estimates the pose of the object in every frame, and a robot arm that\n \
         carries the cameras keeps a chosen pose relative to it.\n"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_file_for_the_system_is_one_of_the_project() {
        for (from, to) in DEPLOYED {
            let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/deploy").join(from);
            assert!(file.is_file(), "{from} for {to}");
        }
    }

    #[test]
    fn the_control_file_has_one_field_a_line() {
        let text = control("0.1.0", "amd64", 20_000);
        assert!(text.contains("\nVersion: 0.1.0\nArchitecture: amd64\n"), "{text}");
        for line in text.lines() {
            assert!(line.starts_with(' ') || line.contains(": "), "`{line}`");
            assert!(line.len() < 90 && !line.ends_with(' '), "`{line}`");
        }
    }
}
