"""What makes changes provable: keys, receipts, the audit log, and transactions that write it."""
