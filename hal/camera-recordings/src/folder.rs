//! Pairs the images of a plain folder.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use pb3dp_hal_api::{CameraError, CameraErrorKind};
use pb3dp_record::images::EXTENSIONS;

/// Left and right file of one pair; one of them may be missing.
#[derive(Debug, Default)]
struct Half {
    left: Option<PathBuf>,
    right: Option<PathBuf>,
}

type Found = BTreeMap<NaturalName, Half>;

/// The pairs of a folder in the order of their names. Either `left<name>` and `right<name>` in the folder itself, or `<name>` in
/// its subfolders `left` and `right`. If an image has no partner, the expected file name is returned, so that the pair is
/// reported as missing it.
pub(crate) fn image_pairs(folder: &Path) -> Result<Vec<(PathBuf, PathBuf)>, CameraError> {
    let mut flat = Found::new();
    for file in images_in(folder)? {
        let stem = stem(&file);
        if let Some(name) = stem.strip_prefix("left") {
            insert(&mut flat, name, true, file)?;
        } else if let Some(name) = stem.strip_prefix("right") {
            insert(&mut flat, name, false, file)?;
        }
    }
    let mut nested = Found::new();
    let (left, right) = (folder.join("left"), folder.join("right"));
    for (subfolder, is_left) in [(&left, true), (&right, false)] {
        if subfolder.is_dir() {
            for file in images_in(subfolder)? {
                let name = stem(&file);
                insert(&mut nested, &name, is_left, file)?;
            }
        }
    }
    match (flat.is_empty(), nested.is_empty()) {
        (false, true) => Ok(completed(flat, |name, side| folder.join(format!("{side}{name}")))),
        (true, false) => Ok(completed(nested, |name, side| folder.join(side).join(name))),
        (true, true) => Err(refuse(
            folder,
            "no images left_*.png and right_*.png (or another format), and no subfolders left and right with images",
        )),
        (false, false) => {
            Err(refuse(folder, "it contains both images and subfolders left and right; keep one of the two"))
        }
    }
}

/// The images of a folder, each with both views, in the order of their names.
pub(crate) fn images_with_both(folder: &Path) -> Result<Vec<PathBuf>, CameraError> {
    let mut images = images_in(folder)?;
    images.sort_by_cached_key(|file| NaturalName::new(&stem(file)));
    if images.is_empty() {
        return Err(refuse(folder, "no images in it"));
    }
    Ok(images)
}

fn refuse(folder: &Path, reason: &str) -> CameraError {
    CameraError::new(CameraErrorKind::Unusable, format!("cannot replay {}: {reason}", folder.display()))
}

fn images_in(folder: &Path) -> Result<Vec<PathBuf>, CameraError> {
    let unreadable = |source: std::io::Error| {
        let message = format!("cannot read the folder {}; check that it exists", folder.display());
        CameraError::caused_by(CameraErrorKind::Unusable, message, source)
    };
    let mut images = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        let extension = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
        if extension.is_some_and(|extension| EXTENSIONS.contains(&&*extension)) && !path.is_dir() {
            images.push(path);
        }
    }
    Ok(images)
}

fn stem(file: &Path) -> String {
    file.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn insert(found: &mut Found, name: &str, is_left: bool, file: PathBuf) -> Result<(), CameraError> {
    let half = found.entry(NaturalName::new(name)).or_default();
    let place = if is_left { &mut half.left } else { &mut half.right };
    match place.replace(file.clone()) {
        None => Ok(()),
        Some(other) => {
            let message = format!("{} and {} are the same image twice; keep one", other.display(), file.display());
            Err(CameraError::new(CameraErrorKind::Unusable, message))
        }
    }
}

/// Fills in the file name expected for a missing image, with its partner's extension.
fn completed(found: Found, path: impl Fn(&str, &str) -> PathBuf) -> Vec<(PathBuf, PathBuf)> {
    let partner = |name: &str, side: &str, other: &Option<PathBuf>| {
        let extension = other.as_ref().and_then(|file| file.extension()).unwrap_or_default().to_string_lossy();
        let mut file = path(name, side).into_os_string();
        file.push(format!(".{extension}"));
        PathBuf::from(file)
    };
    let pair = |(name, half): (NaturalName, Half)| {
        let left = half.left.clone().unwrap_or_else(|| partner(&name.text, "left", &half.right));
        let right = half.right.unwrap_or_else(|| partner(&name.text, "right", &half.left));
        (left, right)
    };
    found.into_iter().map(pair).collect()
}

/// A name for natural sorting: `a2` before `a10`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct NaturalName {
    parts: Vec<Part>,
    text: String,
}

/// Numbers come before text; they are compared by their digits without leading zeros, longer ones being greater.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Part {
    Number(usize, String),
    Text(String),
}

impl NaturalName {
    fn new(name: &str) -> Self {
        let same_kind = |a: &u8, b: &u8| a.is_ascii_digit() == b.is_ascii_digit();
        let part = |run: &[u8]| {
            let text = String::from_utf8_lossy(run).into_owned();
            match run.first().is_some_and(u8::is_ascii_digit) {
                true => {
                    let digits = text.trim_start_matches('0').to_owned();
                    Part::Number(digits.len(), digits)
                }
                false => Part::Text(text),
            }
        };
        Self { parts: name.as_bytes().chunk_by(same_kind).map(part).collect(), text: name.to_owned() }
    }
}
