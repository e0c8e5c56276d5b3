//! The window of failures by which the guard judges an arm.

use pb3dp_hal_api::RecentFailures;

#[test]
fn only_the_last_hundred_count() {
    let mut recent = RecentFailures::default();
    let counts: Vec<u32> = (0..300).map(|number| recent.push(number % 3 != 0 && number < 150)).collect();
    assert_eq!((counts[29], counts[99], counts[149]), (20, 66, 67));
    assert_eq!((counts[199], counts[249]), (34, 0));
    recent.push(true);
    recent.clear();
    assert_eq!(recent.count(), 0);
}
