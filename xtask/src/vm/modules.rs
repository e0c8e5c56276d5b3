//! Kernel modules, with their dependencies.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, bail};

use crate::files;

/// A module to load.
pub struct Module {
    /// Name, with underscores.
    pub name: String,
    pub content: Vec<u8>,
}

/// The modules in their order of loading, after their dependencies; and those that the guest loads itself, whose dependencies
/// are among the first.
///
/// # Errors
/// If the kernel has no such module, or it cannot be read.
pub fn closure(folder: &Path, wanted: &[&str], by_hand: &[&str]) -> anyhow::Result<(Vec<Module>, Vec<Module>)> {
    let files = files::all(folder)?;
    let mut at_start = Vec::new();
    for name in wanted {
        add(&files, name, &mut at_start, 0)?;
    }
    let mut later = Vec::new();
    for name in by_hand {
        let module = read(&files, name)?;
        for needed in needs(&module.content) {
            add(&files, &needed, &mut at_start, 0)?;
        }
        later.push(module);
    }
    Ok((at_start, later))
}

/// Deeper recursion is a cycle.
const DEPTH_MAX: u32 = 20;

fn add(files: &[PathBuf], name: &str, order: &mut Vec<Module>, depth: u32) -> anyhow::Result<()> {
    let name = name.replace('-', "_");
    if order.iter().any(|module| module.name == name) {
        return Ok(());
    }
    if depth > DEPTH_MAX {
        bail!("module {name} depends on itself");
    }
    let module = read(files, &name)?;
    for needed in needs(&module.content) {
        add(files, &needed, order, depth + 1)?;
    }
    order.push(module);
    Ok(())
}

fn read(files: &[PathBuf], name: &str) -> anyhow::Result<Module> {
    let found = files.iter().find(|path| stem(path).as_deref() == Some(name));
    let path = found.with_context(|| {
        format!("the kernel has no module {name}; it is built in, or its folder is missing in MODULE_FOLDERS")
    })?;
    let content = match path.extension().and_then(|ending| ending.to_str()) {
        Some("xz") => unpacked("xz", path)?,
        Some("zst") => unpacked("zstd", path)?,
        _ => std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))?,
    };
    Ok(Module { name: name.to_owned(), content })
}

/// The dependencies of a module: `depends=a,b` in its section `.modinfo`.
fn needs(content: &[u8]) -> Vec<String> {
    const KEY: &[u8] = b"\0depends=";
    let at = content.windows(KEY.len()).position(|bytes| bytes == KEY);
    let list = at.and_then(|at| content[at + KEY.len()..].split(|byte| *byte == 0).next()).unwrap_or_default();
    let names = String::from_utf8_lossy(list).into_owned();
    names.split(',').filter(|name| !name.is_empty()).map(|name| name.replace('-', "_")).collect()
}

/// Output of a decompression program for a file.
pub fn unpacked(program: &str, path: &Path) -> anyhow::Result<Vec<u8>> {
    let mut command = Command::new(program);
    command.args(["--decompress", "--stdout"]).arg(path).stdin(Stdio::null());
    // The length of a kernel follows its packed stream, which `xz` would report as damage.
    command.args((program == "xz").then_some("--single-stream"));
    let output = command.output().with_context(|| format!("cannot start {program}: install it"))?;
    if !output.status.success() {
        bail!("{program} cannot unpack {}: {}", path.display(), String::from_utf8_lossy(&output.stderr).trim_end());
    }
    Ok(output.stdout)
}

/// `arc_rimi` of `arc-rimi.ko.xz`.
fn stem(path: &Path) -> Option<String> {
    let name = path.file_name()?.to_str()?;
    Some(name.split_once(".ko")?.0.replace('-', "_"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn module(needs: &str) -> Vec<u8> {
        format!("\x7fELF..license=GPL\0depends={needs}\0name=x\0").into_bytes()
    }

    #[test]
    fn a_module_comes_after_those_that_it_needs() {
        let folder = std::env::temp_dir().join(format!("pb3dp-modules-{}", std::process::id()));
        std::fs::create_dir_all(folder.join("deeper")).unwrap();
        for (path, needs) in
            [("ftdi-sio.ko", "usbserial,usbcore"), ("deeper/usbserial.ko", "usbcore"), ("usbcore.ko", "")]
        {
            std::fs::write(folder.join(path), module(needs)).unwrap();
        }
        let (order, later) = closure(&folder, &["ftdi_sio"], &[]).unwrap();
        let names: Vec<&str> = order.iter().map(|module| module.name.as_str()).collect();
        assert_eq!(names, ["usbcore", "usbserial", "ftdi_sio"]);
        assert!(later.is_empty());
        let (order, later) = closure(&folder, &[], &["ftdi_sio"]).unwrap();
        assert_eq!((order.len(), later.len()), (2, 1));
        let missing = closure(&folder, &["com20020"], &[]).map(|_| ()).unwrap_err();
        assert!(missing.to_string().contains("no module com20020"), "{missing}");
        std::fs::write(folder.join("usbcore.ko"), module("ftdi_sio")).unwrap();
        assert!(closure(&folder, &["ftdi_sio"], &[]).is_err(), "a cycle ends");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
