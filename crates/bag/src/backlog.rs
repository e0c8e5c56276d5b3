//! The newest messages, limited in time and bytes: images are dropped before all others.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Duration;

use crate::encoded::{Encoded, Kind};

/// Bytes that a message takes in memory besides its own: its fields, and a place in a queue.
const MESSAGE_BYTES: u64 = 128;
/// The newest images that always stay, a stereo pair: otherwise images that are longer than the limit would never be there.
const IMAGES_MIN: usize = 2;

/// Limits of a backlog.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Bytes of all messages, besides the newest two images.
    pub(crate) bytes_max: u64,
    /// Time up to the newest message.
    pub(crate) duration_max: Option<Duration>,
}

/// Messages in the order in which they came.
#[derive(Debug)]
pub(crate) struct Backlog {
    limits: Limits,
    images: Lane,
    others: Lane,
    arrivals: u64,
}

/// Messages of one kind with the number of their arrival.
#[derive(Debug, Default)]
struct Lane {
    messages: VecDeque<(u64, Arc<Encoded>)>,
    bytes: u64,
}

impl Lane {
    fn push(&mut self, arrival: u64, message: Arc<Encoded>) {
        self.bytes += message.bytes() + MESSAGE_BYTES;
        self.messages.push_back((arrival, message));
    }

    fn pop(&mut self) -> Option<Arc<Encoded>> {
        let (_, message) = self.messages.pop_front()?;
        self.bytes -= message.bytes() + MESSAGE_BYTES;
        Some(message)
    }

    fn first_arrival(&self) -> u64 {
        self.messages.front().map_or(u64::MAX, |(arrival, _)| *arrival)
    }
}

impl Backlog {
    pub(crate) fn new(limits: Limits) -> Self {
        Self { limits, images: Lane::default(), others: Lane::default(), arrivals: 0 }
    }

    /// Adds a message, and drops those that exceed the limits: those that are too old; then the oldest images, up to the newest two; then
    /// the oldest of all others.
    pub(crate) fn push(&mut self, message: Arc<Encoded>) {
        let Limits { bytes_max, duration_max } = self.limits;
        let at = message.at;
        self.arrivals += 1;
        let lane = if message.kind == Kind::Image { &mut self.images } else { &mut self.others };
        lane.push(self.arrivals, message);
        for lane in [&mut self.images, &mut self.others] {
            let is_old = |message: &Encoded| duration_max.is_some_and(|max| at.saturating_since(message.at) > max);
            while lane.messages.front().is_some_and(|(_, first)| is_old(first)) {
                lane.pop();
            }
        }
        while self.images.messages.len() > IMAGES_MIN && self.images.bytes + self.others.bytes > bytes_max {
            self.images.pop();
        }
        while self.others.bytes > bytes_max {
            self.others.pop();
        }
    }

    /// Takes the message that came first.
    pub(crate) fn pop(&mut self) -> Option<Arc<Encoded>> {
        let is_image = self.images.first_arrival() < self.others.first_arrival();
        if is_image { self.images.pop() } else { self.others.pop() }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.images.messages.is_empty() && self.others.messages.is_empty()
    }

    /// All messages in the order in which they came.
    pub(crate) fn messages(&self) -> Vec<Arc<Encoded>> {
        let mut all: Vec<_> = self.images.messages.iter().chain(&self.others.messages).collect();
        all.sort_by_key(|(arrival, _)| *arrival);
        all.into_iter().map(|(_, message)| Arc::clone(message)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cdr::Bytes;
    use crate::encoded::Encoder;
    use crate::messages::{CompressedImage, Header, Text, Time};
    use pb3dp_geometry::MonotonicTime;

    const TOPICS: [&str; 2] = ["/image", "/text"];

    fn message(encoder: &mut Encoder, is_image: bool, millis: u64, bytes: usize) -> Arc<Encoded> {
        let at = MonotonicTime::from_nanos(millis * 1_000_000);
        if is_image {
            let header = Header { stamp: Time::default(), frame_id: String::new() };
            let image = CompressedImage { header, format: String::new(), data: Bytes(vec![0; bytes]) };
            encoder.encode(TOPICS[0], at, &image)
        } else {
            encoder.encode(TOPICS[1], at, &Text { data: "a".repeat(bytes) })
        }
    }

    fn left(backlog: &Backlog) -> String {
        let name = |message: &Arc<Encoded>| format!("{}{} ", &message.topic[1..2], message.sequence);
        backlog.messages().iter().map(name).collect::<String>().trim_end().to_owned()
    }

    #[test]
    fn the_oldest_images_are_dropped_before_all_others() {
        let mut backlog = Backlog::new(Limits { bytes_max: 10_000, duration_max: None });
        let mut encoder = Encoder::default();
        for k in 0..5 {
            backlog.push(message(&mut encoder, true, k, 1500));
            backlog.push(message(&mut encoder, false, k, 500));
        }
        assert_eq!(left(&backlog), "t1 i2 t2 i3 t3 i4 t4 i5 t5");
        // The newest two images stay beside any number of others, and these are limited by themselves.
        for k in 5..30 {
            backlog.push(message(&mut encoder, false, k, 500));
        }
        assert!(left(&backlog).starts_with("i4 i5 t16 t17 "), "{}", left(&backlog));
        // So do those that are longer than the limit.
        backlog.push(message(&mut encoder, true, 30, 20_000));
        assert!(left(&backlog).starts_with("i5 t16 ") && left(&backlog).ends_with("t30 i6"), "{}", left(&backlog));
    }

    #[test]
    fn old_messages_are_dropped_and_the_others_are_taken_in_order() {
        let mut backlog = Backlog::new(Limits { bytes_max: 1 << 20, duration_max: Some(Duration::from_millis(20)) });
        let mut encoder = Encoder::default();
        for k in 0..5 {
            backlog.push(message(&mut encoder, true, 10 * k, 10));
            backlog.push(message(&mut encoder, false, 10 * k, 10));
        }
        assert_eq!(left(&backlog), "i3 t3 i4 t4 i5 t5");
        let taken: Vec<u32> = std::iter::from_fn(|| backlog.pop()).map(|message| message.sequence).collect();
        assert_eq!(taken, [3, 3, 4, 4, 5, 5]);
        assert!(backlog.is_empty() && backlog.images.bytes == 0 && backlog.others.bytes == 0);
    }
}
