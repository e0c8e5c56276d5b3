//! Lists the video devices from `/sys/class/video4linux`.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::video::NodeEntry;

/// One link per video device, to the folder of its node below the hardware folder.
pub(super) const CLASS: &str = "/sys/class/video4linux";

/// From a node up to the USB device: node, class folder, interface, device. Higher levels are not searched: they are hubs, whose
/// serial number is not that of the camera.
const LEVELS_MAX: usize = 4;

pub(super) fn entries(class: &Path) -> io::Result<Vec<NodeEntry>> {
    let folder = match fs::read_dir(class) {
        Ok(folder) => folder,
        // Without a driver there is no class folder, and no device.
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(error),
    };
    let mut entries = Vec::new();
    for file in folder {
        let file = file?;
        let name = file.file_name();
        // Radios, sub-devices and similar nodes have other names.
        let Some(number) = name.to_str().and_then(|name| name.strip_prefix("video")) else { continue };
        let Ok(number) = number.parse::<u32>() else { continue };
        entries.push((number, entry(&file.path(), Path::new("/dev").join(&name))));
    }
    entries.sort_by_key(|(number, _)| *number);
    Ok(entries.into_iter().map(|(_, entry)| entry).collect())
}

fn entry(folder: &Path, path: PathBuf) -> NodeEntry {
    let index = read(&folder.join("index")).and_then(|text| text.parse().ok());
    NodeEntry { path, index, serial: serial_of(folder) }
}

/// The serial number of the USB device of a node: the first folder above it with a USB serial number.
fn serial_of(folder: &Path) -> Option<String> {
    let folder = fs::canonicalize(folder).ok()?;
    let device = folder.ancestors().take(LEVELS_MAX).find(|folder| folder.join("idVendor").is_file())?;
    read(&device.join("serial")).filter(|serial| !serial.is_empty())
}

fn read(file: &Path) -> Option<String> {
    fs::read_to_string(file).ok().map(|text| text.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    /// The folders of `/sys` for a USB camera and a virtual camera.
    #[test]
    fn nodes_are_found_with_their_serial_numbers() {
        let root = std::env::temp_dir().join(format!("pb3dp-v4l2-list-{}", std::process::id()));
        let class = root.join("class/video4linux");
        let write = |file: &str, text: &str| {
            let file = root.join(file);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, text).unwrap();
        };
        write("devices/usb1/1-2/idVendor", "046d\n");
        write("devices/usb1/1-2/serial", "4F5A19C0\n");
        for (node, index) in [("video2", "0\n"), ("video10", "1\n")] {
            write(&format!("devices/usb1/1-2/1-2:1.0/video4linux/{node}/index"), index);
        }
        write("devices/platform/vivid.0/video4linux/video0/index", "0\n");
        write("devices/platform/vivid.0/video4linux/radio0/index", "0\n");
        fs::create_dir_all(&class).unwrap();
        for (link, folder) in [
            ("video0", "platform/vivid.0/video4linux/video0"),
            ("radio0", "platform/vivid.0/video4linux/radio0"),
            ("video10", "usb1/1-2/1-2:1.0/video4linux/video10"),
            ("video2", "usb1/1-2/1-2:1.0/video4linux/video2"),
        ] {
            symlink(root.join("devices").join(folder), class.join(link)).unwrap();
        }
        let found = entries(&class).unwrap();
        let missing = entries(&root.join("none")).unwrap();
        fs::remove_dir_all(&root).unwrap();
        let entry = |path: &str, index, serial: Option<&str>| NodeEntry {
            path: path.into(),
            index: Some(index),
            serial: serial.map(str::to_owned),
        };
        let serial = Some("4F5A19C0");
        let expected =
            [entry("/dev/video0", 0, None), entry("/dev/video2", 0, serial), entry("/dev/video10", 1, serial)];
        assert_eq!(found, expected);
        assert_eq!(missing, []);
    }
}
