export function showHealth() {}
