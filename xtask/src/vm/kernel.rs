//! The distribution's kernel: find, fetch, unpack, keep.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use super::modules::unpacked;
use crate::apt::{apt_get, is_root};
use crate::files::{create_folder, read, remove_folder};
use crate::not_possible::NotPossible;
use crate::workspace::output_of;

/// The metapackage that depends on the current kernel: the name of the kernel's package changes with every update.
const METAPACKAGE: &str = "linux-image-amd64";

/// Begins of the paths of modules that are kept; all modules would be 400 MB.
const MODULES: [&str; 11] = [
    "drivers/usb",
    "drivers/net/arcnet",
    "drivers/net/tun.",
    "fs/configfs",
    "drivers/tty",
    "drivers/media/cec",
    "drivers/media/common",
    "drivers/media/mc",
    "drivers/media/rc",
    "drivers/media/test-drivers",
    "drivers/media/v4l2-core",
];

/// Folder of the kept kernel in the cache.
const KEPT: &str = "kernel";

/// File in the folder of a kept kernel with the list of its parts.
const PARTS: &str = "parts";

/// A kernel on disk.
pub struct Kernel {
    /// The kernel image for QEMU.
    pub image: PathBuf,
    /// Root folder of its modules.
    pub modules: PathBuf,
    /// Release, such as `6.1.0-56-amd64`.
    pub release: String,
}

impl Kernel {
    /// The kept kernel, or a new one.
    ///
    /// # Errors
    /// [`NotPossible`] if there is none and none can be fetched; otherwise if it cannot be unpacked.
    pub fn get(cache: &Path, renews: bool) -> anyhow::Result<Self> {
        let kept = cache.join(KEPT);
        // A kernel with other parts than needed now does not count.
        if !renews && read(&kept.join(PARTS)).is_ok_and(|parts| parts == MODULES.join("\n")) {
            return Self::open(&kept);
        }
        let scratch = cache.join("new");
        remove_folder(&scratch)?;
        create_folder(&scratch)?;
        let package = newest_package()?;
        println!("fetching {package}");
        let file = download(&package, &scratch)?;
        unpack(&file, &scratch)?;
        fs::remove_file(&file)?;
        remove_folder(&kept)?;
        // Complete or not at all.
        fs::rename(&scratch, &kept).context("cannot move the new kernel to its folder")?;
        Self::open(&kept)
    }

    fn open(folder: &Path) -> anyhow::Result<Self> {
        let release = read(&folder.join("release"))?;
        Ok(Self { image: folder.join("image"), modules: folder.join("modules"), release })
    }
}

/// Name of the package that the metapackage depends on.
fn newest_package() -> anyhow::Result<String> {
    let mut found = needed_package();
    if found.is_err() && is_root() {
        // A machine that has never run `apt-get update` knows no packages.
        let _ = output_of(apt_get().arg("update"));
        found = needed_package();
    }
    found
}

fn needed_package() -> anyhow::Result<String> {
    let text = output_of(Command::new("apt-cache").args(["depends", METAPACKAGE]))
        .map_err(|error| NotPossible::because(format!("apt provides no kernel: {error:#}; the tests need Debian")))?;
    image_of(&text).map(str::to_owned).ok_or_else(|| {
        NotPossible::because(format!(
            "apt has no package {METAPACKAGE}: run `apt-get update` as root; or this is not Debian"
        ))
    })
}

/// The dependency of the metapackage in the output of `apt-cache depends`.
fn image_of(text: &str) -> Option<&str> {
    let needed = text.lines().filter_map(|line| line.trim().strip_prefix("Depends: "));
    let has_version = |name: &&str| {
        name.strip_prefix("linux-image-").is_some_and(|rest| rest.starts_with(|letter: char| letter.is_ascii_digit()))
    };
    needed.map(str::trim).find(has_version)
}

/// Fetches the file of a package. Needs no special rights.
fn download(package: &str, folder: &Path) -> anyhow::Result<PathBuf> {
    let fetched = output_of(apt_get().args(["download", package]).current_dir(folder));
    fetched.map_err(|error| NotPossible::because(format!("cannot fetch {package}: {error:#}")))?;
    let files = fs::read_dir(folder)?.filter_map(|entry| Some(entry.ok()?.path()));
    let mut files = files.filter(|path| path.extension().is_some_and(|ending| ending == "deb"));
    files.next().with_context(|| format!("apt-get has fetched no file for {package}"))
}

/// Unpacks the kernel and the kept modules.
fn unpack(file: &Path, folder: &Path) -> anyhow::Result<()> {
    let raw = folder.join("raw");
    fs::create_dir_all(&raw)?;
    let mut packed = Command::new("dpkg-deb");
    packed.arg("--fsys-tarfile").arg(file).stdin(Stdio::null()).stdout(Stdio::piped());
    let mut packed = packed.spawn().map_err(|_| NotPossible::because("dpkg-deb is missing: the tests need Debian"))?;
    let mut tar = Command::new("tar");
    tar.args(["--extract", "--wildcards", "--directory"]).arg(&raw);
    if let Some(output) = packed.stdout.take() {
        tar.stdin(Stdio::from(output));
    }
    // Folders that a kernel does not have are no error here: a missing module is reported when it is needed.
    tar.arg("*/vmlinuz-*").args(MODULES.map(|part| format!("*/kernel/{part}*"))).stderr(Stdio::null());
    let _ = tar.status().context("cannot start tar")?;
    if !packed.wait()?.success() {
        bail!("cannot unpack {}: delete it, and try again", file.display());
    }
    let boot = fs::read_dir(raw.join("boot")).context("the package has no kernel")?;
    let names = boot.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let name = names.filter(|name| name.starts_with("vmlinuz-")).max().context("the package has no kernel")?;
    fs::write(folder.join(PARTS), MODULES.join("\n"))?;
    fs::write(folder.join("release"), name.trim_start_matches("vmlinuz-"))?;
    keep_image(&raw.join("boot").join(name), folder)?;
    fs::rename(raw, folder.join("modules")).context("cannot move the modules to their folder")
}

/// Keeps the kernel image, unpacked if possible: unpacking takes an emulated processor seconds at every start.
fn keep_image(packed: &Path, folder: &Path) -> anyhow::Result<()> {
    let bytes = fs::read(packed).with_context(|| format!("cannot read {}", packed.display()))?;
    let image = match payload(&bytes) {
        Some(payload) if payload.starts_with(b"\xfd7zXZ\0") => {
            let file = folder.join("payload");
            fs::write(&file, payload)?;
            let image = unpacked("xz", &file)?;
            fs::remove_file(&file)?;
            image
        }
        _ => bytes,
    };
    fs::write(folder.join("image"), image).context("cannot write the kernel")?;
    fs::remove_file(packed).context("cannot remove the packed kernel")
}

/// Position of the packed kernel in its file, from the header of the boot protocol (Linux, Documentation/arch/x86/boot.rst, 2.08 and later).
fn payload(file: &[u8]) -> Option<&[u8]> {
    let word = |at: usize| Some(u32::from_le_bytes(file.get(at..at + 4)?.try_into().ok()?) as usize);
    if file.get(0x202..0x206)? != b"HdrS" || u16::from_le_bytes(file.get(0x206..0x208)?.try_into().ok()?) < 0x208 {
        return None;
    }
    let sectors = match *file.get(0x1F1)? {
        0 => 4,
        sectors => usize::from(sectors),
    };
    let begin = (sectors + 1) * 512 + word(0x248)?;
    file.get(begin..begin.checked_add(word(0x24C)?)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernel_of_the_day_is_found_by_its_metapackage() {
        let text = "linux-image-amd64\n  Depends: linux-image-6.1.0-56-amd64\n  Conflicts: x\n";
        assert_eq!(image_of(text), Some("linux-image-6.1.0-56-amd64"));
        for other in ["", "linux-image-amd64\n", "linux-image-amd64\n  Depends: linux-image-amd64\n Depends: kmod"] {
            assert_eq!(image_of(other), None, "{other}");
        }
    }

    #[test]
    fn the_packed_kernel_is_found_in_its_file() {
        let mut file = vec![0u8; 4096];
        file[0x1F1] = 2;
        file[0x202..0x206].copy_from_slice(b"HdrS");
        file[0x206..0x208].copy_from_slice(&0x20Fu16.to_le_bytes());
        file[0x248..0x24C].copy_from_slice(&16u32.to_le_bytes());
        file[0x24C..0x250].copy_from_slice(&5u32.to_le_bytes());
        file[3 * 512 + 16..3 * 512 + 21].copy_from_slice(b"inner");
        assert_eq!(payload(&file), Some(&b"inner"[..]));
        file[0x24C..0x250].copy_from_slice(&u32::MAX.to_le_bytes());
        assert_eq!(payload(&file), None);
        assert_eq!(payload(b"\x7fELF"), None);
    }
}
