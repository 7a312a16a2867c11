/* One message per status, in the order 0, -1, -2, .. */

COLD const char *KOOP(status_message)(int status) {
	/* One string: an array of pointers is larger, and is linked even if no message is used. */
	static const char messages[] =
	    "ok\0"
	    "a required pointer is null, or the object is not initialised\0"
	    "a dimension is zero or too large, or sizes do not agree\0"
	    "the caller's storage is too small\0"
	    "a setting is outside its range\0"
	    "an input is NaN or infinite\0"
	    "the result would not be finite in this precision\0"
	    "the covariance, or the controller's Hessian, would not be positive definite\0"
	    "the stored model is damaged, or of another size, precision or dictionary\0"
	    "outlier: the innovation exceeds the threshold of the gate\0"
	    "more bits of the learned model have flipped than can be repaired\0"
	    "the compiled arithmetic is not that of IEEE 754\0"
	    "unknown status";
	const char *message = messages;
	for (int s = status > 0 || status < KOOP_E_ARITHMETIC ? KOOP_E_ARITHMETIC - 1 : status; s < 0; s++) {
		while (*message++) {}
	}
	return message;
}
