// Wide code and tables scroll by themselves: let the keyboard reach them.
for (const wide of document.querySelectorAll("pre, .table-wrapper")) {
  wide.tabIndex = 0;
}
