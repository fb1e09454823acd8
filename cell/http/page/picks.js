export function showPicks() {}
