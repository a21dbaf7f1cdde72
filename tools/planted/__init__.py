"""Single faults planted in the product: which tests find them? (make planted)"""
