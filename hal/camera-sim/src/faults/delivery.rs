//! Delivery faults: pairs that are lost, repeated or late.

use std::collections::VecDeque;

use pb3dp_hal_api::{CameraError, CameraErrorKind};
use pb3dp_sim::camera_faults::{CameraFault, CameraFaultKind};

/// A delivered item with content, number and times.
pub(crate) trait Delivered: Clone {
    /// The content of another item with number and times of this one.
    fn with_content_of(&self, other: &Self) -> Self;
}

/// The last delivered item and the waiting items.
#[derive(Clone, Debug)]
pub(crate) struct Delivery<F> {
    given: Option<F>,
    late: VecDeque<F>,
}

impl<F: Delivered> Delivery<F> {
    pub(crate) fn new() -> Self {
        Self { given: None, late: VecDeque::new() }
    }

    /// The item delivered instead of `fresh` while these faults are active.
    ///
    /// # Errors
    /// `Timeout` if nothing is delivered.
    pub(crate) fn deliver(&mut self, fresh: F, faults: &[CameraFault]) -> Result<F, CameraError> {
        let mut next = fresh;
        for fault in faults {
            match (fault.kind, &self.given) {
                (CameraFaultKind::Frozen | CameraFaultKind::Repeated { as_new: true, .. }, Some(given)) => {
                    next = next.with_content_of(given);
                }
                (CameraFaultKind::Repeated { as_new: false, .. }, Some(given)) => {
                    next = given.with_content_of(given);
                }
                _ => (),
            }
        }
        let late = faults.iter().find_map(|fault| match fault.kind {
            CameraFaultKind::Late { pairs } => Some(pairs as usize),
            _ => None,
        });
        match late {
            Some(pairs) => {
                self.late.push_back(next);
                let due = if self.late.len() > pairs { self.late.pop_front() } else { None };
                next = due.ok_or_else(|| nothing("is late"))?;
            }
            // Waiting items have been overtaken.
            None => self.late.clear(),
        }
        if faults.iter().any(|fault| matches!(fault.kind, CameraFaultKind::Dropped { .. })) {
            return Err(nothing("was lost"));
        }
        self.given = Some(next.clone());
        Ok(next)
    }
}

fn nothing(what: &str) -> CameraError {
    CameraError::new(CameraErrorKind::Timeout, format!("camera: no pair in time; it {what} (injected fault)"))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Content, number.
    impl Delivered for (char, u32) {
        fn with_content_of(&self, other: &Self) -> Self {
            (other.0, self.1)
        }
    }

    fn fault(kind: CameraFaultKind) -> [CameraFault; 1] {
        [CameraFault { kind, from: Duration::ZERO, until: Duration::from_secs(1) }]
    }

    #[test]
    fn what_comes_and_when() {
        let mut delivery = Delivery::new();
        let late = fault(CameraFaultKind::Late { pairs: 2 });
        let steps: [(_, &[CameraFault], _); 12] = [
            (('a', 0), &fault(CameraFaultKind::Frozen), Some(('a', 0))),
            (('b', 1), &[], Some(('b', 1))),
            (('c', 2), &fault(CameraFaultKind::Dropped { share: 1.0 }), None),
            (('d', 3), &fault(CameraFaultKind::Frozen), Some(('b', 3))),
            (('e', 4), &fault(CameraFaultKind::Frozen), Some(('b', 4))),
            (('f', 5), &[], Some(('f', 5))),
            (('g', 6), &fault(CameraFaultKind::Repeated { share: 1.0, as_new: false }), Some(('f', 5))),
            (('h', 7), &late, None),
            (('i', 8), &late, None),
            (('j', 9), &late, Some(('h', 7))),
            (('k', 10), &late, Some(('i', 8))),
            (('l', 11), &[], Some(('l', 11))),
        ];
        for (fresh, faults, expected) in steps {
            assert_eq!(delivery.deliver(fresh, faults).ok(), expected, "{fresh:?}");
        }
    }
}
