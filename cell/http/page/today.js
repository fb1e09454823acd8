export function showToday() {}
