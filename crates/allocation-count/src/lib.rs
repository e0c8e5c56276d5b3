//! A counting wrapper around the system allocator. A test that links this crate uses it, and compares the counts before and after
//! an operation.
//!
//! For tests only: it is the allocator of every program that links this crate.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::sync::atomic::{AtomicUsize, Ordering};

thread_local! {
    static REQUESTS: Cell<usize> = const { Cell::new(0) };
    static BYTES: Cell<usize> = const { Cell::new(0) };
    static IS_LEFT_OUT: Cell<bool> = const { Cell::new(false) };
}

static REQUESTS_OF_ALL: AtomicUsize = AtomicUsize::new(0);
static HELD_BYTES: AtomicUsize = AtomicUsize::new(0);

/// Allocations of the current thread so far.
pub fn requests() -> usize {
    REQUESTS.get()
}

/// Bytes allocated by the current thread so far.
pub fn bytes() -> usize {
    BYTES.get()
}

/// Allocations of all threads so far, except excluded threads.
pub fn requests_of_all_threads() -> usize {
    REQUESTS_OF_ALL.load(Ordering::SeqCst)
}

/// Bytes allocated by all threads together and not yet freed.
pub fn held_bytes() -> usize {
    HELD_BYTES.load(Ordering::SeqCst)
}

/// Excludes the current thread from [`requests_of_all_threads`] from now on.
pub fn leave_this_thread_out() {
    IS_LEFT_OUT.set(true);
}

struct Counting;

fn count(bytes: usize) {
    HELD_BYTES.fetch_add(bytes, Ordering::SeqCst);
    // A thread that is ending has nothing left to count.
    let _ = REQUESTS.try_with(|count| count.set(count.get() + 1));
    let _ = BYTES.try_with(|sum| sum.set(sum.get() + bytes));
    if !IS_LEFT_OUT.try_with(Cell::get).unwrap_or(true) {
        REQUESTS_OF_ALL.fetch_add(1, Ordering::SeqCst);
    }
}

// SAFETY: every call is passed on to the system allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: the caller's promise.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size());
        // SAFETY: the caller's promise.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        HELD_BYTES.fetch_sub(layout.size(), Ordering::SeqCst);
        // SAFETY: the caller's promise.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size);
        HELD_BYTES.fetch_sub(layout.size(), Ordering::SeqCst);
        // SAFETY: the caller's promise.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[cfg(test)]
mod tests {
    use std::hint::black_box;

    use super::*;

    #[test]
    fn what_is_given_back_is_not_held() {
        // Other tests allocate less than this.
        const LARGE: usize = 1 << 24;
        let before = held_bytes();
        let mut large = black_box(vec![1u8; LARGE]);
        assert!(held_bytes() >= before + LARGE - LARGE / 8);
        large.reserve_exact(2 * LARGE);
        assert!(held_bytes() >= before + 3 * LARGE - LARGE / 8);
        drop(black_box(large));
        assert!(held_bytes() < before + LARGE / 8);
    }

    #[test]
    fn each_request_counts_where_it_is_made() {
        let (requests_before, bytes_before) = (requests(), bytes());
        let mut grown = black_box(Vec::<u8>::with_capacity(100));
        grown.reserve_exact(200);
        drop(black_box((grown, vec![0u8; 50])));
        assert_eq!((requests() - requests_before, bytes() - bytes_before), (3, 350));
        const MANY: usize = 1000;
        let counted = [false, true].map(|is_left_out| {
            let work = move || {
                if is_left_out {
                    leave_this_thread_out();
                }
                let before = [requests(), requests_of_all_threads()];
                (0..MANY).for_each(|_| drop(black_box(Box::new([0u8; 64]))));
                [requests() - before[0], requests_of_all_threads() - before[1]]
            };
            std::thread::spawn(work).join().expect("the thread ends")
        });
        assert_eq!(counted.map(|[own, _]| own), [MANY, MANY]);
        // Other threads may allocate in the meantime.
        assert!(counted[0][1] >= MANY && counted[1][1] < MANY, "{counted:?}");
    }
}
