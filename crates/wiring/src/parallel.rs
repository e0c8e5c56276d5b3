//! Two tasks on two processors.

use std::thread::{Builder, scope};

/// Stack of the started thread. A process that locks its memory writes the whole stack at each start; rendering uses less than a tenth of
/// it.
const STACK_BYTES: usize = 512 << 10;

/// Calls both at the same time: `second` on a new thread, or afterwards if the system provides no thread.
pub fn parallel(first: &mut (dyn FnMut() + Send), second: &mut (dyn FnMut() + Send)) {
    let mut is_second_done = false;
    scope(|scope| {
        let thread = Builder::new().name("right camera".to_owned()).stack_size(STACK_BYTES);
        is_second_done = thread.spawn_scoped(scope, &mut *second).is_ok();
        first();
    });
    if !is_second_done {
        second();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Barrier;

    use super::*;

    #[test]
    fn both_are_called_once_and_at_the_same_time() {
        // Each waits for the other: called one after the other they would deadlock.
        let (met, mut firsts, mut seconds) = (Barrier::new(2), 0, 0);
        let mut first = || {
            met.wait();
            firsts += 1;
        };
        parallel(&mut first, &mut || {
            met.wait();
            seconds += 1;
        });
        assert_eq!((firsts, seconds), (1, 1));
    }
}
