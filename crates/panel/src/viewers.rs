//! Who wants which images.

use std::collections::HashMap;
use std::sync::{Mutex, MutexGuard, PoisonError};

use crate::messages::socket::ImageView;

/// Highest rate of images for one client.
pub const FPS_MAX: f64 = 60.0;

/// The images that a client wants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClientImages {
    /// Left and right.
    pub sides: [bool; 2],
    /// Raw or rectified.
    pub view: ImageView,
    /// Highest rate.
    pub fps_max: f64,
    /// Also heat overlays of the left image.
    pub heat: bool,
}

impl ClientImages {
    /// Nothing.
    pub const NOTHING: Self = Self { sides: [false; 2], view: ImageView::Raw, fps_max: 30.0, heat: false };

    /// Whether the client wants any image.
    pub fn is_anything(&self) -> bool {
        self.sides != [false; 2]
    }
}

/// What all clients together want.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wanted {
    /// By view (raw, rectified) and side (left, right).
    pub images: [[bool; 2]; 2],
    /// Highest rate of any client.
    pub fps_max: f64,
    /// Heat overlays.
    pub heat: bool,
}

/// What each client wants.
#[derive(Debug, Default)]
pub struct Viewers(Mutex<HashMap<u64, ClientImages>>);

impl Viewers {
    /// Sets what a client wants.
    pub fn set(&self, client: u64, one_client: ClientImages) {
        let mut clients = self.clients();
        if one_client.is_anything() {
            clients.insert(client, one_client)
        } else {
            clients.remove(&client)
        };
    }

    /// What is to be encoded.
    pub fn wanted(&self) -> Wanted {
        let mut wanted = Wanted::default();
        for one_client in self.clients().values() {
            wanted.fps_max = wanted.fps_max.max(one_client.fps_max);
            wanted.heat |= one_client.heat;
            for (any, one) in wanted.images[one_client.view as usize].iter_mut().zip(one_client.sides) {
                *any |= one;
            }
        }
        wanted
    }

    fn clients(&self) -> MutexGuard<'_, HashMap<u64, ClientImages>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_is_encoded_while_somebody_wants_it() {
        let viewers = Viewers::default();
        assert_eq!(viewers.wanted(), Wanted::default());
        viewers.set(1, ClientImages { sides: [true, false], view: ImageView::Raw, fps_max: 10.0, heat: false });
        viewers.set(2, ClientImages { sides: [true, true], view: ImageView::Rectified, fps_max: 30.0, heat: true });
        assert_eq!(viewers.wanted(), Wanted { images: [[true, false], [true, true]], fps_max: 30.0, heat: true });
        viewers.set(2, ClientImages::NOTHING);
        assert_eq!(viewers.wanted(), Wanted { images: [[true, false], [false, false]], fps_max: 10.0, heat: false });
        viewers.set(1, ClientImages::NOTHING);
        assert_eq!(viewers.wanted(), Wanted::default());
    }
}
