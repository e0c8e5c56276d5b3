//! Devices whose images have both views, by their name or their formats, and how to ask them for pairs.
//!
//! Nothing here has been confirmed with a real device. Sources: Stereolabs, "ZED Open Capture" (both views side by side in `YUYV`); kernel
//! documentation, "V4L2_PIX_FMT_Y8I" (pixels of the left and the right sensor of a RealSense camera alternately).

use pb3dp_camera_settings::{DeviceLayout, ImageLayout, PixelFormat};
use pb3dp_geometry::ImageSize;

use crate::modes::OfferedFormat;
use crate::video::SizeEntry;

/// A model that is recognised.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct KnownModel {
    /// Manufacturer and series.
    pub name: &'static str,
    /// What a user should know of it.
    pub note: &'static str,
    /// How to ask this device for pairs; `None` if it has no images with both views.
    pub proposal: Option<Proposal>,
}

/// Settings with which one device delivers both views.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Proposal {
    /// Arrangement of the views.
    pub layout: DeviceLayout,
    /// Pixel format.
    pub format: PixelFormat,
    /// Sizes of a view, pixels, in the order in which the driver lists them.
    pub views: Vec<ImageSize>,
}

/// Both views side by side are at least this much wider than high; one view of any usual camera is less wide.
const SIDE_BY_SIDE_ASPECT_MIN: u32 = 2;

/// The model of a device with this name and these formats, if it is known.
pub fn recognise(card: &str, formats: &[OfferedFormat]) -> Option<KnownModel> {
    let interleaved = proposal(DeviceLayout::Interleaved, PixelFormat::Y8i, formats);
    if card.starts_with("ZED") {
        return Some(KnownModel {
            name: "Stereolabs ZED",
            note: "both views side by side, left view on the left; calibrate it here, the images are not rectified",
            proposal: proposal(DeviceLayout::OneImage(ImageLayout::SideBySide), PixelFormat::Yuyv, formats),
        });
    }
    if card.contains("RealSense") {
        let note = match interleaved {
            Some(_) => "this node has both infrared views; switch the pattern projector off",
            None => "this node has one view; the node of this device that offers Y8I has both infrared views",
        };
        return Some(KnownModel { name: "Intel RealSense", note, proposal: interleaved });
    }
    interleaved.map(|proposal| KnownModel {
        name: "device with Y8I",
        note: "the pixels of two sensors alternate",
        proposal: Some(proposal),
    })
}

fn proposal(layout: DeviceLayout, format: PixelFormat, formats: &[OfferedFormat]) -> Option<Proposal> {
    let offered = formats.iter().find(|offered| offered.fourcc == format.fourcc())?;
    let view = |(size, _): &(SizeEntry, _)| match (*size, layout) {
        (SizeEntry::Discrete(whole), DeviceLayout::OneImage(arrangement)) => {
            (whole.width >= SIDE_BY_SIDE_ASPECT_MIN * whole.height).then(|| arrangement.half(whole))
        }
        (SizeEntry::Discrete(whole), _) => Some(whole),
        (SizeEntry::Range { .. }, _) => None,
    };
    let views: Vec<ImageSize> = offered.sizes.iter().filter_map(view).collect();
    (!views.is_empty()).then_some(Proposal { layout, format, views })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn offered(fourcc: &[u8; 4], sizes: &[(u32, u32)]) -> OfferedFormat {
        let size = |(width, height): &(u32, u32)| {
            (SizeEntry::Discrete(ImageSize { width: *width, height: *height }), Vec::new())
        };
        OfferedFormat { fourcc: *fourcc, sizes: sizes.iter().map(size).collect() }
    }

    /// Name of the model, and layout, format and first view of what is proposed.
    fn proposed(card: &str, formats: &[OfferedFormat]) -> Option<String> {
        let model = recognise(card, formats)?;
        let of = |p: Proposal| format!(": {} {} {}x{}", p.layout, p.format, p.views[0].width, p.views[0].height);
        Some(format!("{}{}", model.name, model.proposal.map_or_else(String::new, of)))
    }

    #[test]
    fn models_are_known_by_their_names_and_formats() {
        let zed = [offered(b"YUYV", &[(4416, 1242), (2560, 720), (1344, 376)])];
        let infrared = [offered(b"GREY", &[(640, 480)]), offered(b"Y8I ", &[(848, 480), (640, 480)])];
        let colour = [offered(b"YUYV", &[(640, 480)])];
        // The name of a driver has at most 31 letters.
        let realsense = "Intel(R) RealSense(TM) Depth Ca";
        for (card, formats, expected) in [
            ("ZED 2i: ZED 2i", &zed[..], Some("Stereolabs ZED: side-by-side YUYV 2208x1242")),
            (realsense, &infrared, Some("Intel RealSense: interleaved Y8I 848x480")),
            (realsense, &colour, Some("Intel RealSense")),
            ("Other", &infrared, Some("device with Y8I: interleaved Y8I 848x480")),
            ("HD Webcam", &[offered(b"YUYV", &[(1280, 720)])], None),
            // A ZED that offers nothing as wide as two views.
            ("ZED", &colour, Some("Stereolabs ZED")),
        ] {
            assert_eq!(proposed(card, formats).as_deref(), expected, "{card}");
        }
    }
}
