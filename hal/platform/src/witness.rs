//! Scheduling latency of the computer itself: high-priority threads that only sleep, one on each processor.

use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Barrier};
use std::thread::{Builder, JoinHandle, available_parallelism};
use std::time::Duration;

use super::realtime::{Realtime, enter, now, sleep_until};
use crate::jitter::{Jitter, JitterMeter};

/// Above every thread of an arm: only the kernel and the hypervisor delay these threads, if the priority is available.
const PRIORITY: u8 = 90;
/// Period of the threads.
pub const PERIOD: Duration = Duration::from_millis(1);
/// Latency above which a computer cannot keep the cycles of an arm.
pub const TOO_LATE: Duration = Duration::from_millis(5);

/// Threads that measure their own latency.
#[derive(Debug)]
pub struct Witness {
    is_over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<Jitter>>,
}

impl Witness {
    /// Starts one thread on each processor. All of them run when this returns, and allocate nothing until they end.
    ///
    /// # Errors
    /// If the system provides no thread.
    pub fn start() -> io::Result<Self> {
        let mut witness = Self { is_over: Arc::default(), threads: Vec::new() };
        witness.on_each_processor(PRIORITY)?;
        Ok(witness)
    }

    fn on_each_processor(&mut self, priority: u8) -> io::Result<()> {
        for cpu in 0..available_parallelism()?.get() {
            let runs = Arc::new(Barrier::new(2));
            let begun = Arc::clone(&runs);
            self.spawn(move |is_over| {
                watch(&Realtime { priority: Some(priority), locks_memory: false, cpu: Some(cpu) }, &begun, is_over)
            })?;
            runs.wait();
        }
        Ok(())
    }

    fn spawn(&mut self, watch: impl FnOnce(&AtomicBool) -> Jitter + Send + 'static) -> io::Result<()> {
        let is_over = Arc::clone(&self.is_over);
        self.threads.push(Builder::new().name("witness".to_owned()).spawn(move || watch(&is_over))?);
        Ok(())
    }

    /// Largest latency of all threads.
    pub fn end(mut self) -> Jitter {
        self.is_over.store(true, Ordering::Relaxed);
        let worst_first = self.threads.drain(..).filter_map(|thread| thread.join().ok());
        worst_first.max_by_key(|jitter| jitter.max).unwrap_or_default()
    }
}

impl Drop for Witness {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::Relaxed);
    }
}

fn watch(place: &Realtime, begun: &Barrier, is_over: &AtomicBool) -> Jitter {
    // Without the priority the latency includes other programs.
    let _ = enter(place);
    let meter = JitterMeter::default();
    begun.wait();
    while !is_over.load(Ordering::Relaxed) {
        let at = now() + PERIOD;
        sleep_until(at);
        meter.record(now().saturating_since(at));
    }
    meter.summary()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_counts_while_it_lives() {
        let witness = Witness::start().unwrap();
        sleep_until(now() + Duration::from_millis(50));
        let worst_first = witness.end();
        assert!(worst_first.cycles > 0 && worst_first.max >= worst_first.p50, "{worst_first:?}");
    }
}
