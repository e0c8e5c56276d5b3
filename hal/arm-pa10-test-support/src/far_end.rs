//! A gateway at the far end of a real line, in its own thread, with injectable line faults.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use pb3dp_hal_platform::realtime::{Realtime, enter};
use pb3dp_hal_platform::transport::{ByteLink, wait};

use crate::gateway::FakeGateway;

/// Injectable faults of the line.
#[derive(Default)]
pub struct Line {
    /// This many of the next pieces of answers are lost.
    pub drop_answers: AtomicU32,
    /// Sent before the next answer.
    pub noise: Mutex<Vec<u8>>,
    /// The far end neither reads nor answers.
    pub stalled: AtomicBool,
    pub closed: AtomicBool,
}

pub struct FarEnd {
    pub gateway: Arc<Mutex<FakeGateway>>,
    pub line: Arc<Line>,
    thread: Option<JoinHandle<Instant>>,
}

impl FarEnd {
    /// Serves this end until it is closed.
    pub fn serve(bytes: Box<dyn ByteLink>, gateway: FakeGateway) -> Self {
        Self::serve_after(bytes, gateway, || {})
    }

    /// As [`Self::serve`], after an action of the new thread.
    pub fn serve_after(bytes: Box<dyn ByteLink>, gateway: FakeGateway, begin: fn()) -> Self {
        let gateway = Arc::new(Mutex::new(gateway));
        let line = Arc::new(Line::default());
        let (of_thread, line_of_thread) = (Arc::clone(&gateway), Arc::clone(&line));
        let thread = std::thread::spawn(move || {
            begin();
            // Real-time where permitted: this thread stands for a separate device.
            enter(&Realtime { priority: Some(40), locks_memory: false, cpu: None });
            pump(bytes, &of_thread, &line_of_thread)
        });
        Self { gateway, line, thread: Some(thread) }
    }

    /// Unplugs the line; returns the time.
    pub fn unplug(&mut self) -> Instant {
        self.line.closed.store(true, Ordering::SeqCst);
        self.thread.take().unwrap().join().unwrap()
    }
}

impl Drop for FarEnd {
    fn drop(&mut self) {
        self.line.closed.store(true, Ordering::SeqCst);
    }
}

fn pump(mut bytes: Box<dyn ByteLink>, gateway: &Mutex<FakeGateway>, line: &Line) -> Instant {
    let begin = Instant::now();
    let mut buffer = [0; 512];
    while !line.closed.load(Ordering::SeqCst) {
        if line.stalled.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(2));
            continue;
        }
        wait(Some(bytes.as_ref()), false, None, Duration::from_millis(2));
        // The other side may disconnect and return.
        let Ok(count) = bytes.try_read(&mut buffer) else { break };
        let mut answer = std::mem::take(&mut *line.noise.lock().unwrap());
        {
            let mut gateway = gateway.lock().unwrap();
            gateway.clock_us = begin.elapsed().as_micros() as u64;
            answer.extend(gateway.answer(&buffer[..count]));
        }
        if !answer.is_empty() {
            let drop = |left: u32| left.checked_sub(1);
            if line.drop_answers.fetch_update(Ordering::SeqCst, Ordering::SeqCst, drop).is_err() {
                let _ = bytes.try_write(&answer);
            }
        }
    }
    drop(bytes);
    Instant::now()
}
